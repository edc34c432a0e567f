"""What presses where: the rim on its wave generator, by compliance.

A nodal ring force of every harmonic gives the rim's compliance; the forces follow from the shape, held from both sides
or from one. No element of the bearing is meshed: it is a pressure per closing, or rigid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from edge_daemon.design.harmonics import Rings
from edge_daemon.records import Array

MOST_ROUNDS = 60
"""Rounds of the active set; it settles in 3 to 25, and what does not goes to the slow sure way."""


@dataclass(frozen=True, slots=True)
class Pressed:
    """A deformed flexspline: harmonics (h,), displacement amplitudes (h, 3 nodes) [m], and the contact's forces."""

    harmonics: Any
    displacement: Array
    angles_rad: Array
    places_m: Array
    """z of the contact's nodes"""
    force_N_per_rad: Array
    """(nodes, angles), positive outwards"""


def press(compliance: Array, wanted: Array) -> Array:
    """Forces >= 0 with `compliance @ forces >= wanted`, one or the other an equality (contact from one side).

    `compliance` (n, n) symmetric and positive, `wanted` (n,). Active set after Hueber & Wohlmuth (2005), else the
    non-negative least squares of Lawson & Hanson (1974).
    """
    active = wanted > 0.0
    slack = 1e-9 * float(np.abs(wanted).max())
    seen: set[bytes] = set()
    for _ in range(MOST_ROUNDS):
        forces = np.zeros(len(wanted))
        inside = np.flatnonzero(active)
        forces[inside] = np.linalg.solve(compliance[np.ix_(inside, inside)], wanted[inside])
        gap = compliance @ forces - wanted
        new = (active & (forces > 0.0)) | (~active & (gap < -slack))
        if bool((new == active).all()):
            return forces
        if new.tobytes() in seen:
            break
        seen.add(new.tobytes())
        active = new
    lower = np.linalg.cholesky(compliance)
    return np.asarray(nnls(lower.T, np.linalg.solve(lower, wanted), maxiter=30 * len(wanted))[0])


def held_shape(rings: Rings, nodes: Any, sizes_m: Array, harmonics: Any) -> Pressed:
    """`nodes` follow a shape of radial amplitudes `sizes_m` (h,) exactly, pushed or pulled."""
    fields, forces = [], []
    for harmonic, size in zip(harmonics, sizes_m, strict=True):
        unit, compliance = _unit_forces(rings, int(harmonic), nodes)
        force = np.linalg.solve(compliance, np.full(len(nodes), size))
        fields.append(unit @ force)
        forces.append(force)
    angles = np.linspace(0.0, 0.5 * np.pi, 37)
    around = np.array(forces).T @ np.cos(np.outer(harmonics, angles))
    return Pressed(np.asarray(harmonics), np.array(fields), angles, rings.nodes[nodes, 1], around)


def one_sided(rings: Rings, nodes: Any, shape_m: Array, softness_m_per_N: Array) -> Pressed:
    """`nodes` may leave the shape (angles,) [m] outwards; each closes by `softness` per force per radian.

    The angles are evenly spaced from the major to the minor axis; there are as many harmonics as angles.
    """
    steps = len(shape_m) - 1
    angles, harmonics = np.linspace(0.0, 0.5 * np.pi, steps + 1), np.arange(0, 2 * steps + 1, 2)
    ends = np.where((angles == 0.0) | (angles == angles[-1]), 0.5, 1.0)
    waves = np.cos(np.outer(harmonics, angles))
    parts = np.where((harmonics == 0) | (harmonics == 2 * steps), 1.0, 2.0)[:, None] * waves * ends / steps
    units, matrices = zip(*(_unit_forces(rings, int(n), nodes) for n in harmonics), strict=True)
    whole = np.einsum("nij,nk,nl->ikjl", np.array(matrices), waves * ends, parts)
    size = len(nodes) * (steps + 1)
    whole = whole.reshape(size, size)
    whole[np.diag_indices(size)] += np.outer(softness_m_per_N, ends).ravel()
    forces = press(0.5 * (whole + whole.T), np.tile(shape_m * ends, len(nodes))).reshape(len(nodes), -1)
    fields = np.array([unit @ (forces @ part) for unit, part in zip(units, parts, strict=True)])
    return Pressed(harmonics, fields, angles, rings.nodes[nodes, 1], forces)


def _unit_forces(rings: Rings, harmonic: int, nodes: Any) -> tuple[Array, Array]:
    """Fields for a unit ring force on each node, and the nodes' own compliance."""
    forces = np.zeros((rings.size, len(nodes)))
    forces[3 * np.asarray(nodes), np.arange(len(nodes))] = 1.0
    fields = rings.solve(harmonic, forces)
    return fields, fields[3 * np.asarray(nodes)]

"""The elements against closed forms of rings, tubes, plates and shells that share nothing with them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.design.contact import held_shape, press
from edge_daemon.design.harmonics import Elastic, Rings, isotropic
from edge_daemon.design.mesh import Meridian
from edge_daemon.design.solve import twist

pytest.importorskip("skfem")
E, NU = 190e9, 0.3
G = E / (2 * (1 + NU))


def rings(points: np.ndarray, rim: int, middle: float = 0.0, mirrored: bool = False) -> Rings:
    mesh = Meridian(points, rim, middle, mirrored)
    stiffness = np.broadcast_to(isotropic(E, NU), (mesh.elements.shape[1], 6, 6))
    return Rings(mesh, Elastic(stiffness, 8000.0))


def tube(radius: float, thick: float, length: float, elements: int, rows: int = 5) -> np.ndarray:
    """A straight wall, (stations, rows, 2) [m]."""
    across = np.linspace(radius - thick / 2, radius + thick / 2, rows)
    along = np.linspace(0.0, length, 2 * elements + 1)
    return np.stack(np.broadcast_arrays(across[None, :], along[:, None]), axis=-1)


def plate(inner: float, outer: float, thick: float, elements: int) -> np.ndarray:
    """Flat from its outer edge to its clamp."""
    along = np.linspace(outer, inner, 2 * elements + 1)
    across = np.linspace(0.0, thick, 5)
    return np.stack(np.broadcast_arrays(along[:, None], across[None, :]), axis=-1)


@pytest.mark.parametrize(("radius", "thick"), [(0.025, 0.0005), (0.04, 0.0006)])
def test_a_thin_ring_bends_as_the_curvature_says(radius: float, thick: float) -> None:
    """1.5 E t w0 / r^2 at the surface, from the change of curvature 3 w0 / r^2."""
    w0 = 1e-4
    ring = rings(tube(radius, thick, 0.5 * thick, 2), 5, 0.5 * thick, mirrored=True)
    middle = ring.mesh.numbers[-1, 2]
    pressed = held_shape(ring, np.array([middle]), np.array([w0]), np.array([2]))
    stress = ring.stresses(2, pressed.displacement[0])[ring.mesh.numbers[-1], 1]
    assert 0.5 * (stress[-1] - stress[0]) == pytest.approx(1.5 * E * thick * w0 / radius**2, rel=0.005)


@pytest.mark.parametrize("length", [0.03, 0.06])
def test_a_thin_tube_twists_as_the_textbook_says(length: float) -> None:
    radius, thick = 0.025, 0.00035
    short = 1e-4
    points = tube(radius, thick, length, 60)
    points[:3, :, 1] = np.linspace(0.0, short, 3)[:, None]
    _, stiffness = twist(rings(points, 3), 1.0)
    assert stiffness == pytest.approx(2 * math.pi * radius**3 * thick * G / length, rel=0.005)


def test_a_plate_with_a_hub_twists_as_the_textbook_says() -> None:
    """K = 4 pi G t / (1/a^2 - 1/b^2): the shear flow of a disc falls with the square of the radius."""
    inner, outer, thick = 0.012, 0.025, 0.0005
    disc = rings(plate(inner, outer, thick, 30), 1)
    edge = disc.mesh.numbers[0]
    forces = np.zeros((disc.size, 1))
    forces[3 * edge + 1, 0] = np.array([1, 4, 2, 4, 1]) / 12.0 / (2 * math.pi * outer)
    turned = disc.solve(0, forces)[3 * edge[2] + 1, 0] / outer
    assert 1 / turned == pytest.approx(4 * math.pi * G * thick / (inner**-2 - outer**-2), rel=0.005)


@pytest.mark.parametrize("harmonic", [0, 2, 4])
def test_a_plate_with_a_hub_bends_as_kirchhoff_says(harmonic: int) -> None:
    """Clamped at the hub, a ring force of some harmonic on its edge: the four constants of Kirchhoff's plate."""
    inner, outer, thick = 0.012, 0.025, 0.0002
    disc = rings(plate(inner, outer, thick, 40), 1)
    edge = disc.mesh.numbers[0]
    forces = np.zeros((disc.size, 1))
    forces[3 * edge + 2, 0] = np.array([1, 4, 2, 4, 1]) / 12.0
    moved = disc.solve(harmonic, forces)[3 * edge[2] + 2, 0]
    assert moved == pytest.approx(_kirchhoff(harmonic, inner, outer, thick, 1.0 / outer), rel=0.01)


def _kirchhoff(n: int, a: float, b: float, thick: float, force_N_per_m: float) -> float:
    """Edge deflection of an annular plate, from its general solution by powers of the radius (unit b)."""
    stiffness = E * thick**3 / (12 * (1 - NU**2))
    terms = [(0, 0), (2, 0), (0, 1), (2, 1)] if n == 0 else [(n, 0), (-n, 0), (n + 2, 0), (2 - n, 0)]

    def value(r: float, term: tuple[int, int], order: int) -> float:
        p, log = term
        f = {0: r**p, 1: p * r ** (p - 1), 2: p * (p - 1) * r ** (p - 2), 3: p * (p - 1) * (p - 2) * r ** (p - 3)}
        if not log:
            return f[order]
        ln = math.log(r)
        return {
            0: f[0] * ln,
            1: f[1] * ln + r ** (p - 1),
            2: f[2] * ln + (2 * p - 1) * r ** (p - 2),
            3: f[3] * ln + (3 * p * p - 6 * p + 2) * r ** (p - 3),
        }[order]

    def moment(r: float, t: tuple[int, int]) -> float:
        w, d1, d2 = (value(r, t, k) for k in range(3))
        return d2 + NU * (d1 / r - n * n * w / r**2)

    def shear(r: float, t: tuple[int, int]) -> float:
        w, d1, d2, d3 = (value(r, t, k) for k in range(4))
        plain = d3 + d2 / r - d1 / r**2 - n * n * d1 / r**2 + 2 * n * n * w / r**3
        return plain - (1 - NU) * n * n / r * (d1 / r - w / r**2)

    rows = [[value(a / b, t, 0) for t in terms], [value(a / b, t, 1) for t in terms]]
    rows += [[moment(1.0, t) for t in terms], [-shear(1.0, t) for t in terms]]
    sizes = np.linalg.solve(np.array(rows), [0, 0, 0, -force_N_per_m * b**3 / stiffness])
    return abs(float(sum(s * value(1.0, t, 0) for s, t in zip(sizes, terms, strict=True))))


def test_the_end_of_a_long_cylinder_yields_as_a_shell() -> None:
    """A radial line force on the end: w = Q / (2 b^3 D), with b^4 = 3 (1 - nu^2) / (r t)^2."""
    radius, thick = 0.05, 0.0005
    shell = rings(tube(radius, thick, 0.05, 160), 1)
    edge = shell.mesh.numbers[0]
    forces = np.zeros((shell.size, 1))
    forces[3 * edge, 0] = np.array([1, 4, 2, 4, 1]) / 12.0 * radius
    moved = shell.solve(0, forces)[3 * edge[2], 0]
    decay = (3 * (1 - NU**2)) ** 0.25 / math.sqrt(radius * thick)
    assert moved == pytest.approx(1.0 / (2 * decay**3 * E * thick**3 / (12 * (1 - NU**2))), rel=0.01)


def test_rigid_motion_strains_nothing() -> None:
    """Harmonic 1 holds a shift across the axis: u_r = cos, u_t = -sin."""
    ring = rings(tube(0.02, 0.001, 0.01, 3), 3)
    shift = np.tile([1.0, -1.0, 0.0], len(ring.nodes))
    assert np.abs(ring.stresses(1, shift)).max() < 1e-6 * E


def test_pressing_keeps_every_condition_of_contact() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        root = rng.normal(size=(30, 30))
        compliance, wanted = root @ root.T + 0.1 * np.eye(30), rng.normal(size=30)
        forces = press(compliance, wanted)
        gap = compliance @ forces - wanted
        assert (forces >= 0).all() and (gap > -1e-6).all() and np.abs(forces * gap).max() < 1e-6

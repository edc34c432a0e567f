"""Torques and frequencies that bound a design: buckling, ratcheting, natural frequencies.

Buckling and ratcheting are estimates in closed form; a maker's test decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from edge_daemon.design.drawing import MM, CupSection, wall_thickness_mm
from edge_daemon.design.harmonics import Rings
from edge_daemon.design.solve import Solved
from edge_daemon.records import Array

KNOCK_DOWN = 0.67
"""Imperfect cylinders twist away at two thirds of theory (NASA SP-8007, 2020, section 4.1.3: gamma of torsion)."""
PRESSURE_ANGLE = {"involute": 30.0, "S": 25.0}
"""Angle between a flank and the radius [deg]: the involute of splines; a S-profile's mean flank (guess)."""
BESIDE = 0.37
"""Share of the rim's own yielding that is left beside a wave generator (guess: with it a cup like the maker's size 20
slips at the maker's 260 to 330 N m)."""
MODES = 2
"""Natural frequencies per harmonic that are told."""
HARMONICS = (0, 2, 3, 4)
"""A wave generator excites even ones; 3 and the torsional 0 are what a free test by hammer shows."""


@dataclass(frozen=True, slots=True)
class Mode:
    """A natural frequency of the flexspline alone, clamped at its hub."""

    harmonic: int
    frequency_hz: float


def buckling_torque_Nm(solved: Solved) -> float:
    """Torque at which the wall twists into folds; NaN for a ring without a wall.

    Clamped cylinder, moderate length: tau = 0.747 gamma^(3/4) E / (1 - nu^2)^(5/8) (t / r)^(5/4) sqrt(r / L)
    (NASA SP-8007 revision 2, 2020, torsion; Batdorf 1947).
    """
    body, material = solved.drawing.flexspline, solved.material
    if body.kind == "pancake":
        return math.nan
    section = CupSection(body)
    radius, thick = body.mean_radius_mm, wall_thickness_mm(body)
    length = section.inner_face(section.bore) - section.step()[3] + thick
    shear = 0.747 * KNOCK_DOWN**0.75 * material.youngs_Pa / (1.0 - material.poisson**2) ** 0.625
    shear *= (thick / radius) ** 1.25 * math.sqrt(radius / length)
    return float(2.0 * math.pi * (radius * MM) ** 2 * thick * MM * shear)


def ratcheting_torque_Nm(solved: Solved) -> float:
    """Torque at which the teeth of the major axis would slip; NaN without teeth.

    Tooth forces push the rim inwards by T tan(a) / r over both lobes; the wave generator carries that at the major
    axis, and beside it the rim yields, as under harmonics 4 to 8. Teeth slip when their depth of engagement, twice the
    deflection, is spent.
    """
    teeth = solved.drawing.teeth
    if teeth is None:
        return math.nan
    angle = math.radians(teeth.pressure_angle_deg or PRESSURE_ANGLE[teeth.profile])
    mesh = solved.mesh
    middle = int(np.argmin(np.abs(mesh.points[: mesh.rim_stations, 0, 1] - mesh.rim_middle_m)))
    node = int(mesh.numbers[middle, -1])
    radius = float(mesh.nodes[node, 0])
    yields = 0.0
    for harmonic in (4, 6, 8):
        force = np.zeros((solved.rings.size, 1))
        force[3 * node] = 1.0
        yields += float(solved.rings.solve(harmonic, force)[3 * node, 0])
    per_Nm = math.tan(angle) / radius / (2.0 * math.pi) * 2.0 * BESIDE * yields
    depth = 2.0 * (solved.drawing.wave_generator.radial_deflection_mm or _deflected_mm(solved)) * MM
    return depth / per_Nm


def _deflected_mm(solved: Solved) -> float:
    """Largest radial displacement at the rim's middle [mm]."""
    return float(solved.displacement(np.zeros(1))[0, :, 0].max()) / MM


def natural_frequencies(rings: Rings) -> list[Mode]:
    """The lowest ones of each harmonic, without wave generator and load, sorted."""
    mass, found = _whole(rings.mass_band()), []
    for harmonic in HARMONICS:
        held = rings.held(harmonic)
        free = np.setdiff1d(np.arange(rings.size), held)
        zero = np.zeros(rings.size)

        def inverse(vector: Array, harmonic: int = harmonic, free: Array = free, zero: Array = zero) -> Array:
            full = zero.copy()
            full[free] = vector.ravel()
            return np.asarray(rings.solve(harmonic, full[:, None])[free, 0])

        matrix = _whole(rings.band(harmonic))[free][:, free]
        operator = LinearOperator((len(free), len(free)), matvec=inverse, dtype=float)
        start = np.ones(len(free))
        squares = eigsh(
            matrix, k=MODES, M=mass[free][:, free], sigma=0.0, OPinv=operator, v0=start, return_eigenvectors=False
        )
        found += [Mode(harmonic, math.sqrt(abs(square)) / (2.0 * math.pi)) for square in squares]
    return sorted(found, key=lambda mode: mode.frequency_hz)


def _whole(band: Array) -> sparse.csr_matrix:
    """A symmetric matrix from its lower band."""
    offset, column = np.nonzero(band)
    values = band[offset, column]
    row, off = column + offset, offset > 0
    rows, columns = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
    whole = sparse.coo_matrix((np.concatenate([values, values[off]]), (rows, columns)), shape=(band.shape[1],) * 2)
    return sparse.csr_matrix(whole)

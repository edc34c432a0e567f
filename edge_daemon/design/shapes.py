"""Shapes of wave generators: radial deflection over the angle from the major axis.

Every shape is that of a ring that does not stretch: without a mean, 1 at the major axis, symmetric about both axes. A
measured contour keeps its own size.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from edge_daemon.design.contact import press
from edge_daemon.design.drawing import DesignError, Generator
from edge_daemon.records import Array

SAMPLES = 720
"""Angles around, of which a shape's mean and harmonics are taken: half a degree."""
DISC_ECCENTRICITY = 3.5
"""Of a double disc's centres, in radial deflections: Ivanov (Wave gear drives, 1981) gives 3.3 to 3.6."""
RING_TERMS = 60
"""Harmonics of a ring's own shape under forces: the next term of the series is 1e-7 of the first."""

Shape = Callable[[Array], Array]


def deflection(generator: Generator, bore_mm: float) -> Shape:
    """Radial deflection [mm] as a function of the angle [rad], of a generator inside a bore of radius `bore_mm`."""
    if generator.shape == "measured":
        return _measured(generator, bore_mm)
    size = generator.radial_deflection_mm or 0.0
    shape = SHAPES[generator.shape.replace("-", "_")](generator, bore_mm)
    angles = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    mean = float(shape(angles).mean())
    top = float(shape(np.zeros(1))[0]) - mean
    return lambda angle: size * (shape(angle) - mean) / top


def _cosine(generator: Generator, bore_mm: float) -> Shape:
    return lambda angle: np.cos(2.0 * angle)


def _ellipse(generator: Generator, bore_mm: float) -> Shape:
    """The radius of an ellipse as long around as the bore, less the bore's."""
    long = bore_mm + (generator.radial_deflection_mm or 0.0)
    grid = 0.5 * np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES

    def excess(short: float) -> float:
        return float(np.hypot(long * np.sin(grid), short * np.cos(grid)).mean() * 0.5 * np.pi - 0.5 * np.pi * bore_mm)

    short = float(brentq(excess, 0.5 * bore_mm, long))
    return lambda angle: long * short / np.hypot(short * np.cos(angle), long * np.sin(angle)) - bore_mm


def _four_force(generator: Generator, bore_mm: float) -> Shape:
    """A ring under four forces at +-b from its major axis: sum of cos(n b) cos(n t) / (n^2 - 1)^2 over even n
    (Timoshenko, Strength of Materials part II, 1956, rings; Ivanov 1981)."""
    orders = np.arange(2, 2 * RING_TERMS + 1, 2)
    sizes = np.cos(orders * np.radians(generator.force_angle_deg)) / (orders**2 - 1.0) ** 2
    return lambda angle: np.cos(np.multiply.outer(angle, orders)) @ sizes


def _double_disc(generator: Generator, bore_mm: float) -> Shape:
    """A ring that two discs press outwards: it lies on them near the major axis and is free between."""
    deflected = generator.radial_deflection_mm or 0.0
    off = generator.disc_eccentricity_mm or DISC_ECCENTRICITY * deflected
    if off <= deflected:
        raise DesignError(
            f"wave_generator.disc_eccentricity_mm: {off:g} is not above the deflection ({deflected:g}):"
            " discs as large as the bore cannot bend it"
        )
    angles = np.linspace(0.0, 0.5 * np.pi, RING_TERMS + 1)
    orders = np.arange(2, 2 * RING_TERMS + 1, 2)
    ends = np.where((angles == 0.0) | (angles == angles[-1]), 0.5, 1.0)
    waves = np.cos(np.outer(angles, orders))
    compliance = (waves / (orders**2 - 1.0) ** 2) @ waves.T * np.outer(ends, ends)
    wanted = (deflected - off + off * np.cos(angles)) * ends
    forces = press(compliance, wanted) * ends
    sizes = (forces @ waves) / (orders**2 - 1.0) ** 2
    return lambda angle: np.cos(np.multiply.outer(angle, orders)) @ sizes


def _measured(generator: Generator, bore_mm: float) -> Shape:
    """The symmetric part of a measured contour about its own major axis; radii are taken less their mean [mm]."""
    rows = np.array(sorted(generator.contour or []), dtype=float)
    angles = np.radians(rows[:, 0])
    if np.ptp(rows[:, 0]) < 300.0 and not np.isclose(np.ptp(rows[:, 0]), 90.0, atol=10.0):
        raise DesignError("wave_generator.contour: expected angles over a whole turn, or over one quarter")
    if np.ptp(rows[:, 0]) < 300.0:
        quarter, values = angles - angles[0], rows[:, 1]
        angles = np.concatenate([s * quarter + k * np.pi for k in (0, 1) for s in (1, -1)])
        rows = np.column_stack([angles, np.tile(values, 4)])
    orders = np.arange(2, min(24, len(np.unique(np.mod(angles, 2 * np.pi))) // 2), 2)
    columns = [np.ones_like(angles), *(f(n * angles) for n in orders for f in (np.cos, np.sin))]
    sizes = np.linalg.lstsq(np.column_stack(columns), rows[:, 1], rcond=None)[0][1:].reshape(-1, 2)
    turn = np.arctan2(sizes[0, 1], sizes[0, 0]) / orders[0]
    even = sizes[:, 0] * np.cos(orders * turn) + sizes[:, 1] * np.sin(orders * turn)
    top = float(even.sum())
    if not 0.0 < top < 0.1 * bore_mm:
        raise DesignError(
            f"wave_generator.contour: its major axis stands out by {top:.4g} mm: expected less than r / 10"
        )
    return lambda angle: np.cos(np.multiply.outer(angle, orders)) @ even


SHAPES = {"cosine": _cosine, "ellipse": _ellipse, "four_force": _four_force, "double_disc": _double_disc}

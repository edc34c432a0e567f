"""The meridian section as a strip of second-order quadrilaterals, graded towards its fillets.

A flexspline's section is a strip: along it run stations, across it a few elements. Stations are numbered from the open
end to the clamp, so that every matrix is a band.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from edge_daemon.design.drawing import MM, CupSection, DesignError, Flexspline
from edge_daemon.records import Array

GROWTH = 1.35
"""Neighbouring elements differ by no more than a third, as is usual for second-order elements."""
ACROSS = 3
"""Second-order elements across the thickness: two give 2 % less at a step that is bent hard, four 0.1 % more."""
ARC_ELEMENTS = 5
"""Elements on 45 degrees of a fillet: with eight the stress of the reference cup's step moves by 0.2 %."""
DECAY = 0.2
"""Largest element as a share of sqrt(r t), the length over which a cylinder's edge disturbance dies away."""

CONTACT_ELEMENTS = 6
"""Elements along half the rim's width: with nine the contact's stresses move by less than 1 %."""

Face = Callable[[float], tuple[float, float]]
PLACES = ((0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1))
"""Station and row of an element's nodes, in the order of scikit-fem's second-order quadrilateral."""


@dataclass(frozen=True, slots=True)
class Meridian:
    """Nodes of the section [m] as (stations, rows, 2): radius and z; row 0 is the bore, the last the teeth's side."""

    points: Array
    rim_stations: int
    """stations 0 to this (not included) lie under the rim"""
    rim_middle_m: float
    """z of the middle of the rim's width"""
    mirrored: bool
    """a pancake: half of it, the last station its plane of symmetry"""

    @property
    def numbers(self) -> Any:
        """Node numbers, (stations, rows)."""
        stations, rows, _ = self.points.shape
        return np.arange(stations * rows).reshape(stations, rows)

    @property
    def nodes(self) -> Array:
        """(n, 2) in the order of `numbers`."""
        return self.points.reshape(-1, 2)

    @property
    def elements(self) -> Any:
        """Node numbers of each element, (9, elements)."""
        at = self.numbers
        along, across = np.meshgrid(np.arange(0, at.shape[0] - 1, 2), np.arange(0, at.shape[1] - 1, 2), indexing="ij")
        return np.array([at[(along + i).ravel(), (across + j).ravel()] for i, j in PLACES])


def meridian(body: Flexspline, fineness: float = 1.0, contact_mm: float = 0.0) -> Meridian:
    """The mesh of a section; `fineness` 2 halves every element, and a contact of some width gets nodes at its edges."""
    pieces = _Strip(fineness)
    if body.kind == "pancake":
        return _pancake(body, pieces, contact_mm)
    section = CupSection(body)
    _rim(section, pieces, contact_mm)
    rim_stations = pieces.stations
    _step_and_wall(section, pieces)
    _corner_and_diaphragm(section, pieces)
    return Meridian(pieces.points(), rim_stations, 0.5 * section.rim_width * MM, False)


def _pancake(body: Flexspline, pieces: _Strip, contact_mm: float) -> Meridian:
    bore, half = body.mean_radius_mm - 0.5 * body.rim_thickness_mm, 0.5 * body.length_mm
    for begin, end, size in (piece for piece in _under_contact(half, half, contact_mm) if piece[1] <= half + 1e-9):
        pieces.add(begin, end, size, size, half / 12, *_plain(bore, bore + body.rim_thickness_mm))
    return Meridian(pieces.points(), pieces.stations, half * MM, True)


def _under_contact(half: float, middle: float, width: float) -> list[tuple[float, float, float]]:
    """Pieces of half a rim before and after its middle: (begin, end, element size), cut at the contact's edges."""
    size = half / CONTACT_ELEMENTS
    if not 0.0 < width < 2.0 * half - 1e-9:
        return [(middle - half, middle, size), (middle, middle + half, size)]
    inner, own = 0.5 * width, min(0.5 * width / 2, size)
    before = [(middle - half, middle - inner, own), (middle - inner, middle, own)]
    return [*before, (middle, middle + inner, own), (middle + inner, middle + half, own)]


def _plain(bore: float, top: float) -> tuple[Face, Face]:
    """Straight faces of one thickness."""
    return lambda z: (bore, z), lambda z: (top, z)


class _Strip:
    """Collects pairs of curves, bore side and teeth's side, piece by piece."""

    def __init__(self, fineness: float) -> None:
        self.fineness = fineness
        self.inner: list[tuple[float, float]] = []
        self.outer: list[tuple[float, float]] = []

    @property
    def stations(self) -> int:
        return len(self.inner)

    def add(self, begin: float, end: float, first: float, last: float, most: float, inner: Face, outer: Face) -> None:
        """A piece whose parameter runs from `begin` to `end`, with element sizes at its ends and at the most."""
        places = begin + graded(end - begin, *(size / self.fineness for size in (first, last, most)))
        middles = 0.5 * (places[1:] + places[:-1])
        for place in np.sort(np.concatenate([places[1:] if self.inner else places, middles])):
            self.inner.append(inner(float(place)))
            self.outer.append(outer(float(place)))

    def points(self) -> Array:
        """(stations, rows, 2) [m]."""
        rows = 2 * math.ceil(ACROSS * self.fineness - 1e-9) + 1
        share = np.linspace(0.0, 1.0, rows)[None, :, None]
        return np.asarray(MM * (np.array(self.inner)[:, None] * (1.0 - share) + np.array(self.outer)[:, None] * share))


def graded(length: float, first: float, last: float, most: float) -> Array:
    """Places from 0 to `length` whose spacing grows from `first` and from `last`, up to `most`."""
    if length <= 0.0:
        raise DesignError(f"flexspline: a piece of the section has no length ({length:.3g} mm)")
    sides, sizes = ([0.0], [0.0]), [min(first, most), min(last, most)]
    while sides[0][-1] + sides[1][-1] < length:
        side = 0 if sizes[0] <= sizes[1] else 1
        sides[side].append(sides[side][-1] + sizes[side])
        sizes[side] = min(sizes[side] * GROWTH, most)
    whole = sides[0][-1] + sides[1][-1]
    places = np.unique(np.round([*sides[0], *(whole - place for place in sides[1])], 12))
    return np.asarray(places * (length / whole))


def _sizes(section: CupSection) -> tuple[float, float, float]:
    """Element sizes [mm]: at fillets, in the rim, elsewhere."""
    body, wall = section.body, section.wall(section.rim_width)
    fine = min((body.fillet_mm or wall) * 0.25 * math.pi / ARC_ELEMENTS, 0.4 * wall)
    return fine, 0.5 * section.rim_width / CONTACT_ELEMENTS, DECAY * math.sqrt(section.bore * wall)


def _rim(section: CupSection, pieces: _Strip, contact_mm: float) -> None:
    fine, most, _ = _sizes(section)
    half, faces = 0.5 * section.rim_width, _plain(section.bore, section.bore + section.body.rim_thickness_mm)
    for begin, end, size in _under_contact(half, half, contact_mm):
        last = min(fine, size) if end > 2.0 * half - 1e-9 else size
        pieces.add(begin, end, min(size, 0.5 * most) if begin < 1e-9 else size, last, most, *faces)


def _step_and_wall(section: CupSection, pieces: _Strip) -> None:
    fine, _, most = _sizes(section)
    bore, top, edge = section.bore, section.bore + section.body.rim_thickness_mm, section.rim_width
    wall, fillet, begin, end = section.step()
    if fillet > 0.0:
        pieces.add(edge, begin, fine, fine, fine, lambda z: (bore, z), lambda z: (top - (z - edge), z))
        middle = bore + wall + fillet
        arc = lambda z: (middle - math.sqrt(max(fillet**2 - (z - end) ** 2, 0.0)), z)  # noqa: E731
        pieces.add(begin, end, fine, fine, fine, lambda z: (bore, z), arc)
    corner = section.corner()[0]
    pieces.add(end, corner, fine, fine, most, lambda z: (bore, z), lambda z: (bore + section.wall(z), z))


def _corner_and_diaphragm(section: CupSection, pieces: _Strip) -> None:
    """Concave is the face with the fillet: inside a cup, outside a hat's wall."""
    fine, _, most = _sizes(section)
    side, begin, foot = section.side, *section.corner()
    fillet, length = section.body.fillet_mm or 0.0, section.body.length_mm
    turn = 0.5 * math.pi - math.radians(section.body.back_cone_deg)
    wall = section.wall(length)
    line, edge = (section.bore, section.bore + wall) if side < 0 else (section.bore + wall, section.bore)

    def arc(share: float) -> tuple[float, float]:
        angle = share * turn
        return line + side * fillet * (1.0 - math.cos(angle)), begin + fillet * math.sin(angle)

    def add(first: float, last: float, sizes: tuple[float, float, float], concave: Face, convex: Face) -> None:
        pieces.add(first, last, *sizes, *((concave, convex) if side < 0 else (convex, concave)))

    half = (fine / (fillet * turn),) * 3
    add(0.0, 0.5, half, arc, lambda s: (edge, begin + 2 * s * (length - begin)))

    def face(s: float) -> tuple[float, float]:
        radius = edge + (2 * s - 1.0) * (foot - edge)
        return radius, section.outer_face(radius)

    add(0.5, 1.0, half, arc, face)

    def radius_at(share: float) -> float:
        return foot + side * share

    add(
        0.0,
        side * (section.hub - foot),
        (fine, min(fine, 0.2 * section.diaphragm(section.hub)), most),
        lambda s: (radius_at(s), section.inner_face(radius_at(s))),
        lambda s: (radius_at(s), section.outer_face(radius_at(s))),
    )

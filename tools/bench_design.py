"""Finite elements of `design` against closed forms, an independent solver, a solid in three dimensions; and times.

    .venv/bin/python tools/bench_design.py [reference] [times] [solid] [optimum]

Prints a table: what, ours, theirs, difference, change with a finer mesh.
"""

from __future__ import annotations

import copy
import itertools
import math
import sys
import time
import warnings
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from edge_daemon.design.drawing import drawing_of
from edge_daemon.design.evaluate import figures
from edge_daemon.design.harmonics import scikit_fem
from edge_daemon.design.mesh import Meridian
from edge_daemon.design.optimise import document_of, optimise
from edge_daemon.design.solve import solve
from edge_daemon.text import number, table

REFERENCE: dict[str, Any] = {
    "flexspline": {
        "mean_radius_mm": 25.0, "length_mm": 30.0, "wall_mm": 0.35, "rim_width_mm": 10.0, "rim_thickness_mm": 0.9,
        "diaphragm_thickness_mm": 0.5, "hub_radius_mm": 12.0, "fillet_mm": 0.5,
    },
    "wave_generator": {"shape": "cosine", "radial_deflection_mm": 0.25, "contact": "bore"},
    "material": {"youngs_modulus_GPa": 190.0, "poisson": 0.3, "density_kg_m3": 8000.0, "ultimate_MPa": 2000.0},
    "load": {"torque_Nm": 50.0},
}  # fmt: skip
GIVEN = (
    ("torsional stiffness [N m/rad]", "bore", "stiffness", 50600.0),
    ("shear in the wall [MPa]", "bore", "shear", 36.4),
    ("volume [mm3]", "bore", "volume", 3304.0),
    ("hoop at the open end, bore held [MPa]", "bore", "hoop", 389.0),
    ("von Mises, bore held [MPa]", "bore", "von_mises", 705.0),
    ("hoop at the open end, one line [MPa]", "line", "hoop", 118.0),
    ("von Mises, one line [MPa]", "line", "von_mises", 191.0),
)
"""The reference cup by an independent solver of the same kind."""


def told(document: dict[str, Any], fineness: float = 1.0) -> dict[str, float]:
    """The figures that the table needs, in its units."""
    found = figures(drawing_of(document), fineness)
    return {
        "stiffness": found.solved.stiffness_Nm_per_rad,
        "shear": found.shear_Pa * 1e-6,
        "volume": found.solved.volume_m3 * 1e9,
        "hoop": found.stresses.hoop_Pa * 1e-6,
        "bending": found.stresses.bending_Pa * 1e-6,
        "von_mises": found.stresses.von_mises_Pa * 1e-6,
    }


def with_contact(contact: str, **more: Any) -> dict[str, Any]:
    """The reference cup under another contact."""
    document = copy.deepcopy(REFERENCE)
    document["wave_generator"] |= {"contact": contact, **more}
    return document


def reference() -> list[tuple[str, ...]]:
    """Against the independent solver."""
    ours = {name: (told(with_contact(name)), told(with_contact(name), 1.5)) for name in ("bore", "line")}
    return [row(what, ours[contact][0][key], theirs, ours[contact][1][key]) for what, contact, key, theirs in GIVEN]


def row(what: str, ours: float, theirs: float, finer: float) -> tuple[str, ...]:
    """One line of the table."""
    return what, number(ours), number(theirs), f"{ours / theirs - 1:+.2%}", f"{finer / ours - 1:+.2%}"


class Solid:
    """A quarter of a flexspline in second-order bricks of scikit-fem, turned about the axis: no harmonics."""

    def __init__(self, mesh: Meridian, around: int) -> None:
        fem = scikit_fem()
        corners = np.unique(mesh.elements[:4])
        flat = np.searchsorted(corners, mesh.elements[:4])
        count, turns = len(corners), around + 1
        angles = np.linspace(0.0, 0.5 * math.pi, turns)
        r, z = mesh.nodes[corners].T
        points = np.stack([np.outer(np.cos(angles), r), np.outer(np.sin(angles), r), np.tile(z, (turns, 1))])
        layers = [flat + k * count for k in range(turns)]
        bricks = [np.vstack([high, low])[[0, 4, 3, 1, 7, 5, 2, 6]] for low, high in itertools.pairwise(layers)]
        plain = fem.MeshHex(points.reshape(3, -1).copy(), np.hstack(bricks))
        curved = fem.MeshHex2.from_mesh(plain)
        self.mesh = curved
        self.fem, self.section = fem, mesh
        self._bend()
        self.basis = fem.Basis(self.mesh, fem.ElementVector(fem.ElementHex2()), intorder=4)

    def _bend(self) -> None:
        """Middle nodes of the bricks onto their circles; along the section their faces stay straight."""
        places = self.mesh.doflocs.copy()
        elements = self.mesh.dofs.element_dofs
        local = np.asarray(self.fem.ElementHex2().doflocs)
        vertices = places[:, elements[:8]]
        own = local[:8]
        for k in range(8, 27):
            shares = np.prod(1.0 - np.abs(own - local[k]), axis=1)
            radius = np.einsum("v,ve->e", shares, np.hypot(vertices[0], vertices[1]))
            angle = np.einsum("v,ve->e", shares, np.arctan2(vertices[1], vertices[0]))
            places[0, elements[k]], places[1, elements[k]] = radius * np.cos(angle), radius * np.sin(angle)
        self.mesh = type(self.mesh)(places, self.mesh.t, sort_t=False)

    def _numbers(self, places: Any) -> Any:
        """Degrees of freedom (3, nodes) of the mesh's own nodes."""
        scalar = self.fem.Basis(self.mesh, self.fem.ElementHex2(), intorder=1)
        number = np.zeros((3, places.shape[1]), dtype=int)
        vector = self.basis.element_dofs.reshape(27, 3, -1)
        for k in range(27):
            number[:, scalar.element_dofs[k]] = vector[k]
        return number

    def bent(self, youngs: float, poisson: float, w0: float, rim_m: float) -> float:
        """Bore held to w0 cos 2t by stiff springs: the strain energy [J] of the quarter."""
        fem = self.fem
        from skfem.helpers import ddot, sym_grad, trace  # type: ignore[import-untyped]

        shear, lame = youngs / (2 * (1 + poisson)), youngs * poisson / ((1 + poisson) * (1 - 2 * poisson))

        @fem.BilinearForm
        def elastic(u: Any, v: Any, w: Any) -> Any:
            e, d = sym_grad(u), sym_grad(v)
            return 2 * shear * ddot(e, d) + lame * trace(e) * trace(d)

        stiffness = elastic.assemble(self.basis)
        bore, places = float(self.section.points[0, 0, 0]), self.mesh.doflocs
        radius = np.hypot(places[0], places[1])
        nodes = np.flatnonzero((np.abs(radius - bore) < 1e-6 * bore) & (places[2] <= rim_m + 1e-9))
        number = self._numbers(places)
        spring, force = 1e3 * youngs * bore, np.zeros(stiffness.shape[0])
        normal = places[:2, nodes] / radius[nodes]
        shift = w0 * np.cos(2 * np.arctan2(places[1, nodes], places[0, nodes]))
        rows, columns, values = [], [], []
        for a in range(2):
            force[number[a, nodes]] += spring * shift * normal[a]
            for b in range(2):
                rows.append(number[a, nodes])
                columns.append(number[b, nodes])
                values.append(spring * normal[a] * normal[b])
        held = coo_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=stiffness.shape
        )
        matrix = (stiffness + held).tocsc()
        hub = float(self.section.points[-1, 0, 0])
        clamp = self.basis.get_dofs(lambda x: np.abs(np.hypot(x[0], x[1]) - hub) < 1e-3 * hub).all()
        sides = np.concatenate(
            [
                self.basis.get_dofs(lambda x: np.abs(x[1]) < 1e-9).all("u^2"),
                self.basis.get_dofs(lambda x: np.abs(x[0]) < 1e-9).all("u^1"),
            ]
        )
        free = np.setdiff1d(np.arange(len(force)), np.concatenate([clamp, sides]))
        moved = np.zeros(len(force))
        moved[free] = spsolve(matrix[free][:, free], force[free], permc_spec="MMD_AT_PLUS_A")
        return 0.5 * float(moved @ (stiffness @ moved))


def solid() -> list[tuple[str, ...]]:
    """The same cup in three dimensions: its strain energy with the bore held, by both ways."""
    document = with_contact("bore")
    document["load"] = {"torque_Nm": 0.0}
    solved = solve(drawing_of(document))
    amplitude = solved.pressed.displacement[0]
    rings = solved.rings
    band = rings.band(2)
    forces = band[0] * amplitude
    for offset in range(1, len(band)):
        forces[offset:] += band[offset, : len(amplitude) - offset] * amplitude[: len(amplitude) - offset]
        forces[: len(amplitude) - offset] += band[offset, : len(amplitude) - offset] * amplitude[offset:]
    ours = 0.25 * math.pi * 0.5 * float(amplitude @ forces)
    rows = []
    coarse = solve(drawing_of(document), 0.34).mesh
    for around in (6, 10):
        started = time.perf_counter()
        energy = Solid(coarse, around).bent(190e9, 0.3, 0.25e-3, 10e-3)
        rows.append(
            (
                f"strain energy, solid with {around} bricks a quarter [J]",
                number(ours),
                number(energy),
                f"{ours / energy - 1:+.2%}",
                f"{time.perf_counter() - started:.0f} s",
            )
        )
    return rows


def times() -> list[tuple[str, ...]]:
    """Seconds of one solution, with its stresses."""
    rows = []
    for name, document in (
        ("bore", with_contact("bore")),
        ("line", with_contact("line")),
        ("one-sided, 3 mm", with_contact("one-sided", contact_width_mm=3.0)),
        ("one-sided, 10 mm", with_contact("one-sided", contact_width_mm=10.0)),
    ):
        drawing = drawing_of(document)
        spans = []
        for _ in range(3):
            started = time.perf_counter()
            figures(drawing)
            spans.append(time.perf_counter() - started)
        rows.append(
            (name, f"{min(spans):.2f} s", f"{told(document)['hoop']:.1f}", f"{told(document)['von_mises']:.1f}")
        )
    return rows


def optimum() -> list[tuple[str, ...]]:
    """Three weightings of the article's F, each against random designs about its optimum."""
    rows = []
    for weights in ((1.0, 500.0, 0.1), (1.0, 0.0, 0.0), (0.1, 100.0, 0.5)):
        document = with_contact("one-sided", contact_width_mm=3.0)
        document["optimise"] = {"weights": weights, "stiffness_min_Nm_per_rad": 45000.0, "front_points": 0}
        started = time.perf_counter()
        found = optimise(drawing_of(document), lambda what, share: None)
        seconds = time.perf_counter() - started
        told_of, search, rng = document_of(found), found.search, np.random.default_rng(7)
        best = search.cost(found.best, weights)
        least = math.inf
        for _ in range(80):
            share = np.clip(
                found.best.values + rng.normal(size=len(search.knobs)) * 10 ** rng.uniform(-2.5, -0.7), 0, 1
            )
            least = min(least, search.cost(search.trial(share, found.best.shape, 1.0), weights))
        rows.append(
            (str(weights), number(best), f"{1 - least / best:+.2%}", f"{seconds:.0f} s", ", ".join(told_of["binding"]))
        )
    return rows


def main() -> None:
    """All parts, or those that are named."""
    warnings.simplefilter("ignore")
    head = ("what", "ours", "theirs", "difference", "finer mesh")
    wanted = sys.argv[1:] or ["reference", "times", "solid"]
    if "reference" in wanted:
        print(table(head, reference()))
    if "times" in wanted:
        print(table(("contact", "time", "hoop [MPa]", "von Mises [MPa]"), times()))
    if "solid" in wanted:
        print(table((*head[:4], "time"), solid()))
    if "optimum" in wanted:
        print(table(("weights", "F", "best of 80 near it", "time", "held by"), optimum()))


if __name__ == "__main__":
    main()

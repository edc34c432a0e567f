"""Gears with a law outside the catalogue, what a model leaves of them, and a joint beside a torque sensor."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))

from composed_laws import COMPOSED_DRIVE
from engineered_laws import ENGINEERED
from fresh_laws import FIRST_TORSION
from imagined_laws import CLOSED_DRIVE, OPEN_DRIVE, OPEN_TORSION
from outside_laws import DRIVE, LAST_DRIVE, LAST_TORSION, LATER_DRIVE, LATER_TORSION, TORSION
from published_laws import PUBLISHED

from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.proposals import proposals
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.results import Proposal
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.records import Array
from edge_daemon.rig.recording import Simulated, simulate
from edge_daemon.rig.truths import Truth

WRITTEN = [law for law in (*ENGINEERED, *PUBLISHED) if isinstance(law, Truth)]
SEEN = (*TORSION, *LATER_TORSION, *LAST_TORSION, *FIRST_TORSION, *OPEN_TORSION)
LAWS = {law.name: law for law in (*SEEN, *WRITTEN)}
DRIVEN_SEEN = (*DRIVE, *LATER_DRIVE, *LAST_DRIVE, *CLOSED_DRIVE, *OPEN_DRIVE, *COMPOSED_DRIVE)
DRIVEN = {law.name: law for law in DRIVEN_SEEN}
SECONDS = 15.0


def joint(recording: Simulated) -> Model:
    known: dict[str, float] = recording.truth["parameters"]  # type: ignore[assignment]
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    return Model("torsion", known["ratio"], known["inertia_kg_m2"], base)


def left_by(recording: Simulated, model: Model) -> Leftover:
    problem = problem_of([recording], model)
    return Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)


def ignored(what: str, share: float) -> None:
    """Progress."""


def told_of(name: str, *beside: str) -> tuple[Simulated, Model, tuple[Proposal, ...]]:
    recording = simulate(seconds=SECONDS, seed=3, bits_out=24, laws=(DRIVEN[name],), balance="drive")
    model = Model("drive", 100.0, np.nan, tuple(map(ModelEffect, ("inertia", *beside))))
    return recording, model, proposals([recording], model, ignored)


def said_in(ways: int) -> Callable[..., tuple[Proposal, ...]]:
    """Proposals, each so many times, with a part of its belief."""

    def said(*given: object) -> tuple[Proposal, ...]:
        rows = proposals(*given)  # type: ignore[arg-type]
        return tuple(replace(row, probability=row.probability / ways) for row in rows for _ in range(ways))

    return said


def beside_a_sensor(torque_Nm: Callable[[Array, Array], Array], swing_rad: float = 0.0) -> SimpleNamespace:
    """Twelve seconds of a spring of 2e4 N m/rad beside a torque sensor and a pressure; `torque_Nm` (n,) of time and
    output speed is what else the sensor reads. The output may swing faster besides."""
    rng, time_s = np.random.default_rng(2), np.arange(6000) / 500.0
    tones = ((0.9, 1.7), (swing_rad, 7.3))
    angle = sum(size * np.sin(pace * time_s) for size, pace in tones)
    speed = sum(size * pace * np.cos(pace * time_s) for size, pace in tones)
    load = 6.0 * np.sin(3.1 * time_s) + 3.0 * np.sin(11.3 * time_s)
    twist, step = load / 2e4, 2 * math.pi / 2**24
    read = {"theta_in_rad": 100.0 * (angle + twist), "theta_out_rad": angle}
    columns = {name: np.rint(true / step + rng.normal(0, 0.3, len(true))) * step for name, true in read.items()}
    columns["torque_out_Nm"] = load + torque_Nm(time_s, speed) + 5e-3 * rng.normal(size=len(load))
    columns["pressure_bar"] = pressure_bar(time_s)
    return SimpleNamespace(time_s=time_s, columns=columns)


def joined_to_a_sensor() -> Model:
    spring = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    return Model("torsion", 100.0, math.nan, spring)


def pressure_bar(time_s: Array) -> Array:
    return 2.0 + 0.8 * np.sin(0.8 * time_s) + 0.3 * np.sin(2.1 * time_s)

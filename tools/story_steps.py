"""Steps of stories with one encoder, and whether each named what is there: drawn joints, and pieces of real recordings.

Real recordings are those of `bench_real`, whole and cut in three, also without the controller's model torque; where
they are absent, drawn joints remain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import bench_drive
import numpy as np
from bench_real import MACHINES, OF_LOAD, Machine, Plain

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import searched
from edge_daemon.explain.verdict import Verdict, believed
from edge_daemon.records import Array, Mask, Recorded
from edge_daemon.search.belief import samples, scatter
from edge_daemon.search.hypotheses import Hypothesis

FIRST_DRAWN = 200
"""Drawn joints from this number on are learned from; those before are judged by `bench_drive`."""
PIECES = 3
MOST_STEPS = 6


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a story, and what its beliefs are made of; (k,) over the explanations."""

    source: str
    """`drawn`, or the real machine"""
    case: str
    cause: str
    right: bool
    verdict: str
    belief: float
    """of the cause and of what cannot be told from it, as in use"""
    apart_sd: Array
    shy: Array
    numbers: Array
    same: Mask
    """the first, and what cannot be told from it"""
    left: float
    """share of the error's power that the first leaves"""
    gained_sd: float
    """standard deviations between the first and nothing"""


@dataclass(frozen=True, slots=True)
class Told:
    """A recording, the model to begin with, and what is there."""

    source: str
    case: str
    recordings: Sequence[Recorded]
    model: Model
    there: frozenset[str]
    may: frozenset[str]


def drawn(count: int) -> Iterator[Told]:
    """Joints of another hand."""
    for i in range(FIRST_DRAWN, FIRST_DRAWN + count):
        sensing, arm, right, case = bench_drive.drawn(i)
        loaded = OF_LOAD | {"creep_load_friction"} if "load_dependent_friction" in right else frozenset[str]()
        there = frozenset(bench_drive.KNOWN) | set(right) | loaded
        recording = bench_drive.record(arm, 100 + i, sensing=sensing)
        yield Told("drawn", f"{i}: {case}", [recording], bench_drive.model(), there, frozenset())


def real() -> Iterator[Told]:
    """Real recordings, whole and in pieces."""
    for machine in MACHINES:
        if "inertia" not in machine.start:
            continue
        try:
            recordings = machine.read()
        except FileNotFoundError:
            continue
        yield from _pieces(machine, recordings)


def _pieces(machine: Machine, recordings: Sequence[Recorded]) -> Iterator[Told]:
    there = frozenset(name for names in machine.named for name in names.split("|")) | {"inertia"}
    there |= OF_LOAD - {"gravity_load"} if "load_dependent_friction" in there else frozenset()
    model = Model("drive", machine.ratio, math.nan, (ModelEffect("inertia"),))
    whole = [list(recordings)]
    cuts = whole + [[_part(recordings[0], k)] for k in range(PIECES)] if len(recordings) == 1 else whole
    for k, cut in enumerate(cuts):
        for without in ("", "torque_model_Nm"):
            if without and (without not in cut[0].columns or "moving" in machine.name):
                continue
            kept = [Plain(r.time_s, {n: c for n, c in r.columns.items() if n != without}) for r in cut]
            weight = frozenset({"gravity_load"}) if without and "model_torque" in there else frozenset[str]()
            case = f"{machine.name}, {'whole' if not k else f'piece {k}'}{' without ' + without if without else ''}"
            yield Told(machine.name, case, kept, model, there | weight, machine.may)


def _part(recording: Recorded, k: int) -> Plain:
    rows = slice(len(recording.time_s) * k // PIECES, len(recording.time_s) * (k + 1) // PIECES)
    return Plain(recording.time_s[rows], {name: np.asarray(c)[rows] for name, c in recording.columns.items()})


def steps(told: Told) -> Iterator[Step]:
    """The story of a recording, to the step at which it ends; steps whose truth is not known are left out."""
    model, recordings = told.model, told.recordings
    for _ in range(MOST_STEPS):
        try:
            search, found = searched(recordings, model)
        except BadInput:
            return
        verdict = Verdict(model, search)
        worth, said = verdict.kept(verdict.ordered(found)), verdict.diagnosis(found, ())
        if worth:
            parts = set(worth[0].added)
            if parts <= told.there or not parts <= told.there | told.may:
                yield _step(told, verdict, worth, parts <= told.there, said.verdict)
        if said.verdict != "missing":
            return
        model = add_effect(model, worth[0].name, recordings).model


def _step(told: Told, verdict: Verdict, worth: list[Hypothesis], right: bool, said: str) -> Step:
    scatters = np.minimum.accumulate(np.array([scatter(h) for h in worth])[::-1])[::-1]
    counts = np.array([samples(h, verdict.search.regression) for h in worth])
    left = min((worth[0].error / verdict.search.base.error) ** 2, 1.0 - 1e-9)
    return Step(
        told.source,
        told.case,
        worth[0].name,
        right,
        said,
        believed(verdict.candidates(worth)),
        np.sqrt(2.0 * counts * (scatters - scatters.min())),
        np.log([verdict.complexity_weight(h, worth) for h in worth]),
        np.array([h.parameters for h in worth], dtype=float),
        np.array([h is worth[0] or verdict.tied(worth[0], h) for h in worth]),
        left,
        math.sqrt(-counts[0] * math.log(left)),
    )

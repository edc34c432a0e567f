"""Recordings of one joint that a model explains each by itself, but not together: a payload that was changed between
them, another pose or a gear that was mounted anew is no law, but other numbers of the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.explain.compare import lines
from edge_daemon.explain.results import ParameterLine
from edge_daemon.identify.fit import fit
from edge_daemon.identify.solution import STIFFNESS
from edge_daemon.identify.torque_lag import STEADY
from edge_daemon.motion.corrected import senses
from edge_daemon.records import Recorded
from edge_daemon.search.thresholds import EXPLAINED_FLOORS
from edge_daemon.text import with_sd

APART_SD, APART_SHARE = 5.0, 0.03
"""Numbers of two recordings differ by more than so many of their joint standard deviations, and by such a share of the
larger (guess): a fit to each alone takes a little of what the other holds."""


def told_apart(recordings: Sequence[Recorded], model: Model) -> tuple[str, ...]:
    """The line that says which numbers differ between recordings that the model explains one by one; empty where there
    is one recording, or one that it does not explain."""
    if len(recordings) < 2:
        return ()
    if model.balance == "torsion" and model.effect(STEADY) is None:  # their encoders may have been zeroed anew
        model = model.with_effect(ModelEffect(STEADY))
    try:
        fits = [fit([recording], model) for recording in recordings]
    except BadInput:  # too short by itself
        return ()
    levels = [fitted.solution.rmse / fitted.floor for fitted in fits]
    if max(levels) > EXPLAINED_FLOORS:
        return ()
    told = [_said(row) for row in zip(*map(lines, fits), strict=True) if row[0].effect != STEADY and _differs(row)]
    if not told:
        return ()
    alone = (
        f"the model explains each recording alone ({max(levels):.2g} noise floors at most), but not all as one joint"
    )
    by_inertia = STIFFNESS[0] in {row.split()[0] for row in told} and not senses(fits[0].problem.motions[0])
    softer = " (more inertia than the model states looks like a softer spring)" if by_inertia else ""
    return (f"{alone}: {'; '.join(told)}{softer}; diagnose recordings of one payload and one mounting together",)


def _differs(row: Sequence[ParameterLine]) -> bool:
    """Whether a number of each recording is not one number."""
    low, high = (pick(row, key=lambda line: line.value) for pick in (min, max))
    apart = high.value - low.value
    sure = all(line.identified for line in row) and apart > APART_SD * math.hypot(low.sd, high.sd)
    return sure and apart > APART_SHARE * max(abs(low.value), abs(high.value))


def _said(row: Sequence[ParameterLine]) -> str:
    """A number of each recording with its standard deviation, in their order."""
    values = " and ".join(with_sd(line.value, line.sd) for line in row)
    return f"{row[0].effect} {row[0].name} {values} {row[0].unit}"

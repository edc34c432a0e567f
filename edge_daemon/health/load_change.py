"""A load that has become heavier looks like a gear that has become softer: told apart by what changes with it.

Where no torque is measured, it is the load's inertia times its acceleration. With another load (or another gain of a
torque sensor) every torque is off by one factor: stiffness, damping and friction change alike. Wear softens the spring
alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from edge_daemon.health.alarms import Finding
from edge_daemon.records import NE107, Estimate, Status

STIFFNESS = "stiffness"
ALIKE = ("damping", "coulomb_friction")
"""They are torques as the spring's is, and what wears the spring leaves them."""
SPOILED = (STIFFNESS, *ALIKE, "stiffness_change", "hysteresis_area")
"""They are off by the factor."""
SURE = 5.0
"""The stiffness has changed by so many sd, or nothing is to be explained."""
KNOWN = 10.0
"""A stiffness that is so many times as doubtful as before, as in the first second of a gear learned anew, may yet turn
out to have changed (guess)."""
REFUTED, AGREES = 9.0, 4.0
"""Sum of squares, in sd, that refutes that the spring changed alone (squared: whatever else may have), and up to which
a quantity agrees with the factor: odds beyond ten to one."""
OPEN_BLOCKS = 17
"""So many blocks, of 0.3 s, may tell neither before it is taken for the gear's own (guess)."""
Known = dict[str, tuple[float, float]]
"""Logarithm and its sd, by name."""


class LoadChange:
    """Of one drive: `judge` after every block."""

    def __init__(self) -> None:
        self.share = 0.0
        """by which all torques read too little since the change, relatively; 0 for none"""
        self._before: Known = {}
        self._open = 0
        """blocks within which it is to be found what has changed"""

    def judge(self, estimates: Mapping[str, Estimate]) -> Iterable[Estimate]:
        """What is off by the factor, or may be, as invalid: of what was relearned after a contradiction."""
        now = _known(estimates)
        if STIFFNESS not in now:
            self._open = OPEN_BLOCKS if self._before else 0
        elif self._open or self.share:
            self.share, told = _shared(self._before, now)
            self._open = 0 if told else max(self._open - 1, 0)
        if STIFFNESS in now and not self.share and not self._open:
            self._before = now
        if STIFFNESS not in now or not (self.share or self._open):
            return ()
        return tuple(replace(estimates[name], status=Status.INVALID) for name in SPOILED if name in estimates)

    def finding(self) -> Finding:
        """What to do about it."""
        text = (
            f"stiffness, damping and friction read {-self.share:+.1%} all at once, which is the load's inertia ("
            f"{1 / (1 - self.share) - 1:+.1%}) or the torque's scale and not the gear: correct output_inertia_kg_m2"
        )
        return Finding("load change", NE107.FUNCTION_CHECK, self.share != 0.0, self.share != 0.0, text)


def _known(estimates: Mapping[str, Estimate]) -> Known:
    """Those that are valid and have a logarithm."""
    rows = (estimates[name] for name in (STIFFNESS, *ALIKE) if name in estimates)
    valid = (row for row in rows if row.status is Status.VALID and row.value > 0 and row.sd < row.value)
    return {row.name: (math.log(row.value), row.sd / row.value) for row in valid}


def _shared(before: Known, now: Known) -> tuple[float, bool]:
    """By how much all have become less together, 0 where only the stiffness has; and whether that is certain."""
    both = now.keys() & before.keys()
    changes = {name: (now[name][0] - before[name][0], math.hypot(now[name][1], before[name][1])) for name in both}
    softer, sd = changes.pop(STIFFNESS, (0.0, math.inf))
    if STIFFNESS not in both or not changes:
        return 0.0, True
    if abs(softer) < SURE * sd:
        return 0.0, now[STIFFNESS][1] < KNOWN * before[STIFFNESS][1]
    alone = sum((change / own) ** 2 for change, own in changes.values())
    together = sum(((change - softer) / math.hypot(own, sd)) ** 2 for change, own in changes.values())
    if alone > REFUTED and together < AGREES * len(changes):
        return -math.expm1(softer), True
    return 0.0, together > REFUTED * (1.0 if alone < REFUTED else REFUTED)

"""Stiffness against what they were when the drive was commissioned."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from edge_daemon.records import Estimate, Status


@dataclass
class Baseline:
    """Learned once, from the first stiffness that has been valid for `after_s` of data."""

    after_s: float
    valid_s: float = 0.0
    value: float = math.nan
    sd: float = math.nan

    def follow(self, stiffness: Estimate, duration_s: float) -> Estimate:
        """`stiffness_change`: relative to the baseline, minus one; warming up until there is one."""
        if stiffness.status is Status.VALID:
            self.valid_s += duration_s
            if not math.isfinite(self.value) and self.valid_s >= self.after_s:
                self.value, self.sd = stiffness.value, stiffness.sd
        if not math.isfinite(self.value):
            status = Status.INVALID if stiffness.status is Status.INVALID else Status.WARMING_UP
            return Estimate("stiffness_change", math.nan, math.nan, "1", status, stiffness.time_s)
        change = stiffness.value / self.value
        sd = math.hypot(stiffness.sd, change * self.sd) / self.value
        return Estimate("stiffness_change", change - 1.0, sd, "1", stiffness.status, stiffness.time_s)

    def dump(self) -> dict[str, Any]:
        """Plain data; None for a baseline not yet learned."""
        known = math.isfinite(self.value)
        return {"valid_s": self.valid_s, "value": self.value if known else None, "sd": self.sd if known else None}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        self.valid_s = float(state["valid_s"])
        self.value = math.nan if state["value"] is None else float(state["value"])
        self.sd = math.nan if state["sd"] is None else float(state["sd"])

"""Stiffness and noise against what they were when the drive was commissioned."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edge_daemon.records import Array, Estimate, Status


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


@dataclass
class NoiseBaseline:
    """Mean noise coefficients of the first `after_s` of heard sound; learned once.

    The model is linear in its coefficients, so their mean is that of the fitted spectra.
    """

    after_s: float
    heard_s: float = 0.0
    total: Array = field(default_factory=lambda: np.zeros(5))
    """(5,) sum of coefficient times seconds [unit^2/Hz s]"""
    known: Array | None = None
    """(5,) a_0..a_4 at f / reference_hz [unit^2/Hz]; None while commissioning lasts"""

    def follow(self, coefficients: Array, duration_s: float) -> None:
        """Take (5,) fitted coefficients that stood for `duration_s`."""
        if self.known is not None or not np.isfinite(coefficients).all():
            return
        self.heard_s += duration_s
        self.total = self.total + coefficients * duration_s
        if self.heard_s >= self.after_s and self.heard_s > 0:
            self.known = self.total / self.heard_s

    def dump(self) -> dict[str, Any]:
        """Plain data; None for a baseline not yet learned."""
        known = None if self.known is None else self.known.tolist()
        return {"heard_s": self.heard_s, "total": self.total.tolist(), "known": known}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError for anything else."""
        total, known = (np.asarray(state[name] or [0.0] * 5, dtype=float) for name in ("total", "known"))
        if total.shape != (5,) or known.shape != (5,):
            raise ValueError("a noise baseline has five coefficients")
        self.heard_s, self.total = float(state["heard_s"]), total
        self.known = known if state["known"] is not None else None

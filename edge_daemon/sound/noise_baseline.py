"""Noise coefficients against what they were when the drive was commissioned."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edge_daemon.records import Array


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

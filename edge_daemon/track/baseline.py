"""Stiffness against what it was when the drive was commissioned, whatever model it was learned with.

Another model may see another stiffness in the same gear. Its reference is what it makes of the motion that the first
one was learned from, where that is stored; else what was lost so far stays, and what is lost from then on is held
against a reference that the new model learns now.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from edge_daemon.records import Estimate, Status

MOST_MODELS = 16
"""References of so many models are remembered, the newest (guess)."""


@dataclass
class Baseline:
    """Learned from the first stiffness that has been valid for `after_s` of data, and again under another model."""

    after_s: float
    valid_s: float = 0.0
    value: float = math.nan
    sd: float = math.nan
    kept: float = 0.0
    """relative change so far, which another model takes over while it learns its own reference"""
    kept_sd: float = 0.0
    scale: float = 1.0
    """stiffness of the first model over that of this one, in the same gear"""
    _change: float = math.nan
    _change_sd: float = math.nan
    _before: float = math.nan
    """reference under the model before, until this one has been held against it"""
    _newest: float = math.nan
    """stiffness when it was last valid"""
    _seen: float = math.nan
    """what the model before saw last"""
    apart: float = 0.0
    """by which share the first stiffness under this model differs from what was seen last: the models differ, or the
    gear has changed"""
    _again: bool = False
    """whether a model is in force once more, and has yet to see the gear"""
    known: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """reference, its sd and scale of each model that was in force"""
    learned_s: float = math.nan
    """data time at which the reference was learned [s]"""
    learned_share: float = 1.0
    """what was left of the stiffness then, over that of commissioning"""

    def rereference(self, before: str, now: str) -> None:
        """Another model takes over: the change so far is kept, its reference is learned anew, unless it was in force
        once and had one. `before` and `now` tell the two models."""
        if math.isfinite(self._change):
            self.kept, self.kept_sd = self._change, self._change_sd
        if math.isfinite(self.value):
            self._before, self._seen = self.value, self._newest
            self.known[before] = (self.value, self.sd, self.scale)
            self.known = dict([*self.known.items()][-MOST_MODELS:])
        self.value = self.sd = self._change = self._change_sd = self._newest = math.nan
        self.valid_s = self.apart = 0.0
        if now in self.known:
            self.value, self.sd, self.scale = self.known[now]
            self._before, self._again = math.nan, math.isfinite(self._seen)

    @property
    def is_rereferenced(self) -> bool:
        """Whether a model learns its reference that was not the first."""
        return math.isfinite(self._before)

    @property
    def wanted_s(self) -> float:
        """Data time [s] from which this model's reference is to be learned, if that is stored; NaN for none."""
        return self.learned_s if self.is_rereferenced and math.isnan(self.value) else math.nan

    def relearn(self, then: Estimate) -> None:
        """This model's stiffness at the time that was wanted."""
        self.value, self.sd = then.value / self.learned_share, then.sd / self.learned_share

    def follow(self, stiffness: Estimate, duration_s: float) -> Estimate:
        """`stiffness_change`: relative to the baseline, minus one; warming up until there is one."""
        if stiffness.status is Status.VALID:
            self.valid_s, self._newest = self.valid_s + duration_s, stiffness.value
            if self.valid_s >= self.after_s and (self.is_rereferenced or math.isnan(self.value)):
                self._learn(stiffness)
        if math.isfinite(self.value):
            return self._against(stiffness)
        if self.is_rereferenced and stiffness.usable:
            apart = self._beside_before(stiffness)
            self.apart = apart if stiffness.status is Status.VALID and self.valid_s == duration_s else self.apart
            sd = math.hypot(self.kept_sd, apart, stiffness.sd / stiffness.value)
            return Estimate("stiffness_change", self.kept, sd, "1", stiffness.status, stiffness.time_s)
        status = Status.INVALID if stiffness.status is Status.INVALID else Status.WARMING_UP
        return Estimate("stiffness_change", math.nan, math.nan, "1", status, stiffness.time_s)

    def _beside_before(self, stiffness: Estimate) -> float:
        """By which share it differs from what the model before saw last, perhaps by the gear; 0 for unknown."""
        return stiffness.value / self._seen - 1.0 if math.isfinite(self._seen) else 0.0

    def _learn(self, stiffness: Estimate) -> None:
        share = 1.0 + self.kept
        value = stiffness.value / share
        if self.is_rereferenced:
            self.kept_sd = math.hypot(self.kept_sd, self._beside_before(stiffness))
        if self.is_rereferenced:  # what is kept over years goes on where it stood, whatever the reference is
            self.scale *= self._before / value
            self._before = math.nan
        if math.isnan(self.value):
            self.value = value
            self.sd = value * math.hypot(stiffness.sd / stiffness.value, self.kept_sd / share)
            self.learned_s, self.learned_share = stiffness.time_s, share

    def _against(self, stiffness: Estimate) -> Estimate:
        """Only what is valid moves the change; by how much the rest would is doubt."""
        share = stiffness.value / self.value
        sd = math.hypot(stiffness.sd, share * self.sd) / self.value
        if stiffness.status is Status.VALID:
            self.apart = share / (1.0 + self.kept) - 1.0 if self._again else self.apart
            self._change, self._change_sd, self._again = share - 1.0, sd, False
        elif math.isfinite(self._change):
            apart = share - 1.0 - self._change
            return Estimate(
                "stiffness_change", self._change, math.hypot(sd, apart), "1", stiffness.status, stiffness.time_s
            )
        return Estimate("stiffness_change", share - 1.0, sd, "1", stiffness.status, stiffness.time_s)

    def referred(self, stiffness: Estimate) -> Estimate:
        """A stiffness as the first model would see it, for what is kept over years; invalid while that is not known."""
        if self.is_rereferenced:
            return replace(stiffness, status=Status.INVALID)
        return replace(stiffness, value=self.scale * stiffness.value, sd=self.scale * stiffness.sd)

    def dump(self) -> dict[str, Any]:
        """Plain data; None for what is not known."""
        numbers = {name: getattr(self, name) for name in STORED}
        found = {name: value if math.isfinite(value) else None for name, value in numbers.items()}
        return {**found, "known": self.known, "again": self._again}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        for name, unknown in STORED.items():
            value = state.get(name, unknown)
            setattr(self, name, math.nan if value is None else float(value))
        self._again = bool(state.get("again", False))
        self.known = {model: (float(a), float(b), float(c)) for model, (a, b, c) in state.get("known", {}).items()}


STORED = {
    "valid_s": 0.0, "value": None, "sd": None, "kept": 0.0, "kept_sd": 0.0, "scale": 1.0,
    "_change": None, "_change_sd": None, "_before": None, "_newest": None, "_seen": None,
    "apart": 0.0, "learned_s": None, "learned_share": 1.0,
}  # fmt: skip
"""A checkpoint holds these, each with what stands where an older one has none."""

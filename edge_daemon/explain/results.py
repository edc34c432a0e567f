"""What explaining hands back: plain frozen records, each with the JSON that is published."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from edge_daemon.effects.model import Model
from edge_daemon.errors import BadInput
from edge_daemon.records import Array

Json = dict[str, object]


class ExplainError(BadInput):
    """One line: what about the recording or the model keeps it from being explained."""


def number(value: float) -> float | None:
    """A float that JSON can carry: None for NaN and infinities."""
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Error:
    """How wrong a model is on blocks it was not fitted to."""

    nrmse: float
    noise_floor_nrmse: float
    rmse: float
    unit: str

    def to_json(self) -> Json:
        """`error` of compare and diagnose."""
        return {
            "nrmse": number(self.nrmse),
            "noise_floor_nrmse": number(self.noise_floor_nrmse),
            "rmse": number(self.rmse),
            "unit": self.unit,
        }


@dataclass(frozen=True, slots=True)
class Where:
    """One axis along which the residual has structure."""

    axis: str
    share: float
    """of the held-out residual variance that a function of this axis removes, 0 to 1"""
    detail: str

    def to_json(self) -> Json:
        """One row of `where`."""
        return {"axis": self.axis, "share": number(self.share), "detail": self.detail}


@dataclass(frozen=True, slots=True)
class ParameterLine:
    """One fitted number of a model."""

    effect: str
    name: str
    value: float
    sd: float
    unit: str
    identified: bool
    advice: str
    """what would identify it; empty when it is"""

    def to_json(self) -> Json:
        """One row of `parameters`."""
        return {
            "effect": self.effect,
            "name": self.name,
            "value": number(self.value),
            "sd": number(self.sd),
            "unit": self.unit,
            "identified": self.identified,
            "advice": self.advice,
        }


@dataclass(frozen=True, slots=True)
class RegimeCheck:
    """Error in one condition of operation."""

    axis: str
    range: str
    share_of_time: float
    rmse: float
    nrmse: float
    """over the rms torque in this regime"""

    def to_json(self) -> Json:
        """One row of `regimes`."""
        return {
            "axis": self.axis,
            "range": self.range,
            "share_of_time": number(self.share_of_time),
            "rmse": number(self.rmse),
            "nrmse": number(self.nrmse),
        }


@dataclass(frozen=True, slots=True)
class Check:
    """One test of the residual, by block bootstrap: small probability = structure."""

    name: str
    statistic: float
    probability: float

    def to_json(self) -> Json:
        """One row of `tests`."""
        return {"name": self.name, "statistic": number(self.statistic), "probability": number(self.probability)}


@dataclass(frozen=True, slots=True)
class Series:
    """What the plots of a report need, (m,) each, of the rows that were judged."""

    time_s: Array
    torque: Array
    modelled: Array
    residual: Array
    twist_rad: Array
    twist_rate_rad_s: Array
    speed_out_rad_s: Array
    theta_in_rad: Array
    theta_out_rad: Array
    temperature_degC: Array


@dataclass(frozen=True, slots=True)
class OrderSpectrum:
    """A one-sided amplitude spectrum: `order` per turn or frequency [Hz] against amplitude, unit of the balance."""

    axis: str
    at: Array
    amplitude: Array


@dataclass(frozen=True, slots=True)
class Comparison:
    """How wrong the model is, where, and with which parameters."""

    error: Error
    where: tuple[Where, ...]
    parameters: tuple[ParameterLine, ...]
    model: Model
    """as fitted to these recordings"""
    regimes: tuple[RegimeCheck, ...] = ()
    tests: tuple[Check, ...] = ()
    spectra: tuple[OrderSpectrum, ...] = ()
    series: Series | None = None
    warnings: tuple[str, ...] = ()

    def to_json(self) -> Json:
        """The compare contract; further keys only add."""
        return {
            "error": self.error.to_json(),
            "where": [row.to_json() for row in self.where],
            "parameters": [row.to_json() for row in self.parameters],
            "regimes": [row.to_json() for row in self.regimes],
            "tests": [row.to_json() for row in self.tests],
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True, slots=True)
class Candidate:
    """One explanation: an effect, or several joined with `+`."""

    effect: str
    nrmse_before: float
    nrmse_after: float
    probability: float
    confused_with: tuple[str, ...]
    parameters: Mapping[str, float]
    """`effect.parameter` -> fitted value, SI"""
    nrmse_after_sd: float = math.nan
    """from the scatter of the held-out error over blocks"""

    def to_json(self) -> Json:
        """One row of `candidates`."""
        return {
            "effect": self.effect,
            "nrmse_before": number(self.nrmse_before),
            "nrmse_after": number(self.nrmse_after),
            "nrmse_after_sd": number(self.nrmse_after_sd),
            "probability": number(self.probability),
            "confused_with": list(self.confused_with),
            "parameters": {name: number(value) for name, value in self.parameters.items()},
        }


def none_of(candidates: Sequence[Candidate]) -> float:
    """Probability that it is none of them."""
    return max(1.0 - sum(row.probability for row in candidates), 0.0)


@dataclass(frozen=True, slots=True)
class Experiment:
    """A motion that would tell two explanations apart."""

    separates: tuple[str, ...]
    """two explanations; none where the motion is to judge all of them"""
    motion: str
    """what to do, in words"""
    tones_hz: tuple[float, ...]
    speeds_in_rad_s: tuple[float, ...]
    """motor speed amplitude of each tone"""
    seconds: float
    separation: float
    """predicted error of the better wrong model over the noise floor: above 2 the two come apart"""
    limits: Mapping[str, float] = field(default_factory=dict)
    """what the motion keeps within: peak motor speed, peak torque, output travel"""
    needs_hands: bool = False
    """the installation has to be changed first: no motion alone parts the two"""

    def to_json(self) -> Json:
        """`next_experiment`."""
        return {
            "separates": list(self.separates),
            "motion": self.motion,
            "tones_hz": list(self.tones_hz),
            "speeds_in_rad_s": list(self.speeds_in_rad_s),
            "seconds": self.seconds,
            "separation": number(self.separation),
            "limits": {name: number(value) for name, value in self.limits.items()},
            "needs_hands": self.needs_hands,
        }


@dataclass(frozen=True, slots=True)
class SeenCurve:
    """What was seen along one axis beside what a formula says, (k,) each, unit of the balance."""

    axis: str
    at: Array
    seen: Array
    formula: Array

    def to_json(self) -> Json:
        """`curve` of a proposal."""
        return {
            "axis": self.axis,
            "at": [number(x) for x in self.at],
            "seen": [number(x) for x in self.seen],
            "formula": [number(x) for x in self.formula],
        }


@dataclass(frozen=True, slots=True)
class Proposal:
    """A formula for what no effect of the catalogue explains."""

    expression: str
    """as `add NAME --expression` takes it"""
    reads: str
    """the same in words"""
    nrmse_after: float
    probability: float
    range: Mapping[str, tuple[float, float]]
    """axis -> lowest and highest value that it was seen at"""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """amplitude -> fitted value, SI"""
    numbers: int = 0
    """how many were fitted, those that are written into the expression among them"""
    laws: int = 1
    """how many products it adds up"""
    resembles: str = ""
    """the effect of the catalogue that makes most of the same torque; empty where none does"""
    curve: SeenCurve | None = None

    def to_json(self) -> Json:
        """One row of `proposals`."""
        return {
            "expression": self.expression,
            "reads": self.reads,
            "nrmse_after": number(self.nrmse_after),
            "probability": number(self.probability),
            "range": {axis: [number(low), number(high)] for axis, (low, high) in self.range.items()},
            "parameters": {name: number(value) for name, value in self.parameters.items()},
            "resembles": self.resembles or None,
            "curve": None if self.curve is None else self.curve.to_json(),
        }


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What is missing in a model."""

    verdict: str
    """`adequate`, `missing` or `unexplained`"""
    error: Error
    candidates: tuple[Candidate, ...]
    next_experiment: Experiment | None
    where: tuple[Where, ...] = ()
    warnings: tuple[str, ...] = ()
    proposals: tuple[Proposal, ...] = ()
    """formulas, best first, where the catalogue does not explain what is left"""
    with_first: Model | None = None
    """the model with the first candidate as it was found here, orders and shapes within; None where there is none"""

    def to_json(self) -> Json:
        """The diagnose contract; further keys only add."""
        return {
            "verdict": self.verdict,
            "error": self.error.to_json(),
            "candidates": [row.to_json() for row in self.candidates],
            "next_experiment": None if self.next_experiment is None else self.next_experiment.to_json(),
            "where": [row.to_json() for row in self.where],
            "proposals": [row.to_json() for row in self.proposals],
            "warnings": list(self.warnings),
        }

"""What a simulated recording is, whichever balance it serves: what is asked for, what comes of it, its encoders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array
from edge_daemon.rig.motion import MotorMotion
from edge_daemon.text import closest

REFERENCE_DEGC = 25.0
"""The temperature effects vanish here."""
WARM_UP_K = 15.0
WARM_UP_S = 12.0
"""A small gear under load warms up quicker here than in life, so that half a minute shows it (chosen)."""
ENCODER_NOISE_STEPS = 0.25
"""An encoder's noise has this sd before rounding, in its steps (guess; it also keeps rounding errors independent)."""
RATIO = 100.0
ONLY_ASKED = "free_"
"""Begins what an effect has only when it is asked for, and what is not said of it else."""
OF_OUTPUT = 1.0
FREE_ORDER = {"free_order": 0.0, "free_angle": 0.0, "free_phase_rad": 0.0}
"""A wave of any order per turn; `free_angle` says of what: 0 input, 1 output, 2 input against output."""

Temperature = float | tuple[float, float]


class UnknownEffect(BadInput):
    """A name that the simulated drive does not have."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        names = [*known]
        close = closest(name, names)
        hint = f"did you mean {close!r}? It" if close else "the simulated drive"
        super().__init__(f"effect {name!r}: {hint} has: {', '.join(names)}")


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a recording is to hold; the arguments of `recording.simulate`."""

    effects: tuple[str, ...]
    seconds: float
    seed: int
    rate_hz: float
    bits_in: int
    bits_out: int
    motion: str | MotorMotion
    temperature: Temperature | None
    parameters: Mapping[str, float]

    def span(self, warms: bool) -> tuple[float, float]:
        """Temperature at the start and towards the end [degC]; `warms`: an effect needs it to change."""
        if self.temperature is None:
            return (REFERENCE_DEGC, REFERENCE_DEGC + (WARM_UP_K if warms else 0.0))
        return self.temperature if isinstance(self.temperature, tuple) else (self.temperature, self.temperature)

    def truth(self, balance: str, effects: Iterable[str], motion: MotorMotion) -> dict[str, object]:
        """How it was recorded, to be said beside what is true about it."""
        return {
            "balance": balance,
            "effects": [*effects],
            "seed": self.seed,
            "motion": motion.name,
            "seconds": self.seconds,
            "rate_hz": self.rate_hz,
            "bits_out": self.bits_out,
        }


class Given:
    """Parameters that are given rather than drawn."""

    def __init__(self, parameters: Mapping[str, float]) -> None:
        self._parameters = parameters
        self.chosen: dict[str, float] = {}
        """all that were asked for, by name"""

    def value(self, name: str, drawn: float) -> float:
        """What is given under this name, or else what was drawn."""
        self.chosen[name] = float(self._parameters.get(name, drawn))
        return self.chosen[name]

    def of(self, effect: str, drawn: Mapping[str, float]) -> dict[str, float]:
        """The parameters of an effect."""
        unasked = {n for n in drawn if n.startswith(ONLY_ASKED) and f"{effect}.{n}" not in self._parameters}
        return {n: drawn[n] if n in unasked else self.value(f"{effect}.{n}", drawn[n]) for n in drawn}

    def refuse_leftovers(self) -> None:
        """Raises `BadInput` for a name that nothing asked for."""
        for name in self._parameters:
            if name not in self.chosen:
                raise BadInput(f"parameter {name!r}: expected one of {', '.join(self.chosen)}")


@dataclass(frozen=True, slots=True)
class Simulated:
    """A recording and what is true about it."""

    time_s: Array
    columns: dict[str, Array]
    truth: dict[str, object]
    """`effects`, `parameters` (base and effects, `effect.name` -> SI value), `seed` and how it was recorded"""


def temperature_at(time_s: Array, span: tuple[float, float]) -> Array:
    """(n,) [degC] of a warm-up from the first to (nearly) the second."""
    start, end = span
    return np.asarray(start + (end - start) * -np.expm1(-np.maximum(time_s, 0.0) / WARM_UP_S))


def free_order_of_input(given: Mapping[str, float], ratio: float) -> float:
    """Order of a `FREE_ORDER` per turn of the input, of a gear that does not twist: 1e-4 rad moves a tooth by a
    hundredth of its pitch."""
    turns = (1.0, 1.0 / ratio, 1.0 - 1.0 / ratio)
    return given["free_order"] * abs(turns[round(given["free_angle"])])


def quantised(angle_rad: Array, bits: int, rng: np.random.Generator) -> Array:
    """(n,) what an encoder of `bits` per turn says, noise before rounding; unchanged for 0 bits."""
    if bits == 0:
        return angle_rad
    step = 2 * math.pi / 2**bits
    noise = rng.normal(0.0, ENCODER_NOISE_STEPS, len(angle_rad))
    return np.asarray(np.rint(angle_rad / step + noise) * step)

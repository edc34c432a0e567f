"""Effects simulated in the loop: the twist and its rate that the encoders are too coarse to show.

Where friction holds the twist still, its torque follows from the balance, not from the measured rate; the same holds,
less sharply, for hysteresis and gaps. So the torsion is integrated with these laws in it, driven by the measured input,
and held near the measured twist by an observer whose injection only adds damping to its error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.effects.effect import Effect
from edge_daemon.integrator import twist
from edge_daemon.integrator.laws import STOP, Element
from edge_daemon.records import Array, Motion

SUBSTEP_RATE_HZ = 4000.0
"""Four steps lie within the millisecond or two in which friction turns round."""
INJECTION, GENTLE, HELD = 1.0, 0.4, 2.0
"""Observer injection over the torsional resonance [rad/s]: at 2 the observer's error is critically damped. GENTLE where
an element remembers the path, encoder noise with it; HELD while laws are still far off, which soften with speed and
would run off the measured twist."""


def upsampled(signal: Array, times: int) -> Array:
    """(n * times,) band-limited interpolation; a straight line through the ends is taken out before."""
    if signal.ndim > 1:
        return np.stack([upsampled(column, times) for column in signal.T], axis=1)
    n = len(signal)
    if times == 1:
        return signal
    spectrum, length, slope = levelled(signal)
    fine: Array = fft.irfft(spectrum, length * times)[: n * times] * times
    fine += signal[0] + slope * (np.arange(n * times) / times)
    return fine


def slope_of(signal: Array, rate_hz: float) -> Array:
    """(n,) band-limited time derivative; a straight line through the ends is taken out before."""
    spectrum, length, slope = levelled(signal)
    omega = 2j * np.pi * fft.rfftfreq(length, 1 / rate_hz)
    derivative: Array = fft.irfft(spectrum * omega, length)[: len(signal)] + slope * rate_hz
    return derivative


def levelled(signal: Array) -> tuple[NDArray[np.complex128], int, float]:
    """Spectrum of a signal without the straight line through its ends, the length that it was padded to (one of 30 001
    takes ten times as long as one of 30 000), and the slope of the line per sample."""
    n = len(signal)
    slope = float(signal[-1] - signal[0]) / (n - 1)
    length = fft.next_fast_len(n, real=True)
    return fft.rfft(signal - signal[0] - slope * np.arange(n), length), length, slope


@dataclass(frozen=True, slots=True)
class SimulatedTwist:
    """What drives the twist of one trial, at the substep rate, (n * times,) each."""

    times: int
    """substeps per sample"""
    step_s: float
    push: Array
    """inertia times input acceleration over ratio, or the torque where a sensor measures it [N m]"""
    load: Array
    """(n * times, 1 + k) size of the transmitted torque [N m], and what further effects' laws are multiplied by"""
    seen: Array
    """measured twist [rad]"""
    start_rate: float
    held: bool = False
    """whether the observer holds on firmly: laws may be far off"""
    free: bool = False
    """whether there is no observer at all: laws are known, and its noise would shake friction"""

    @property
    def samples(self) -> int:
        """Of the recording."""
        return len(self.push) // self.times


@dataclass(frozen=True, slots=True)
class Spring:
    """The linear part: inertia [kg m^2] (0 where the torque is measured), stiffness, damping."""

    inertia: float
    stiffness: float
    damping: float


@dataclass(frozen=True, slots=True)
class LoopDrive:
    """The simulated twist of one trial, at the substep rate."""

    twist_rad: Array
    rate_rad_s: Array
    torque_Nm: Array
    """of the elements"""


@dataclass(frozen=True, slots=True)
class AngleSensitivity:
    """What a number of the model changes in the loop: of stiffness and damping, and of the elements' numbers; of the
    push [N m] and of the twist [rad], (n,) at the samples, None where it moves neither."""

    spring: tuple[float, float]
    elements: Array
    """(e, 4) of size, a, b, c"""
    push: Array | None = None
    twist: Array | None = None


def course(motion: Motion, inertia: float, speed: Array, held: bool, factors: Sequence[Array]) -> SimulatedTwist:
    """The course of a motion; an inertia of 0 says that the torque is measured. `speed` (n,): of the input over the
    ratio, errors of the angles corrected. `held`: see `SimulatedTwist`. `factors`: (n, k) of each effect with some."""
    times = max(1, round(SUBSTEP_RATE_HZ / motion.rate_hz))
    torque = upsampled(motion.torque_Nm, times)
    push = upsampled(inertia * slope_of(speed, motion.rate_hz), times) if inertia else torque
    seen = upsampled(motion.twist_rad, times)
    step_s = 1 / (motion.rate_hz * times)
    load = np.hstack([np.abs(torque)[:, None], *(upsampled(own, times) for own in factors)])
    return SimulatedTwist(times, step_s, push, load, seen, float(motion.twist_rate_rad_s[0]), held)


def simulated_twist(
    on: SimulatedTwist, spring: Spring, elements: Sequence[Element], extra_Nm: Array | None
) -> LoopDrive:
    """The twist simulated; `extra_Nm` (n,) is what further effects add to the torque on the output, at the samples."""
    return tangent(on, spring, elements, extra_Nm, ())[0]


def tangent(
    on: SimulatedTwist,
    spring: Spring,
    elements: Sequence[Element],
    extra_Nm: Array | None,
    bends: Sequence[AngleSensitivity],
) -> tuple[LoopDrive, Array]:
    """The twist simulated, and (q, n) what the elements' torque changes by with each of q numbers, at the samples."""
    push = on.push if extra_Nm is None else on.push - upsampled(extra_Nm, on.times)
    firmness = HELD if on.held else GENTLE if any(e.kind >= STOP for e in elements) else INJECTION
    followed = spring.inertia > 0 and not on.free
    pull = firmness * math.sqrt(max(spring.stiffness, 0.0) / spring.inertia) * on.step_s if followed else 0.0
    law = packed(elements)
    numbers = twist.Numbers(
        springs=np.array([bend.spring for bend in bends], dtype=float).reshape(-1, 2),
        elements=np.array([bend.elements for bend in bends], dtype=float).reshape(len(bends), len(law), 4),
        pushes=_driven([bend.push for bend in bends], on),
        twists=_driven([bend.twist for bend in bends], on),
    )
    gear = twist.TorsionGear(float(spring.inertia), float(spring.stiffness), float(spring.damping), law)
    forcing = twist.Forcing(push, on.load, on.seen, pull, on.step_s, on.times)
    start = twist.at_rest(float(on.seen[0]), float(on.start_rate), len(law), len(bends))
    found = twist.simulate(gear, forcing, numbers, start)
    return LoopDrive(found.twist, found.rate, found.torque), found.torque_changes


def _driven(signals: Sequence[Array | None], on: SimulatedTwist) -> Array:
    """(q, n + 1) with zeros where there is none; the last sample twice."""
    out = np.zeros((len(signals), on.samples + 1))
    for row, signal in zip(out, signals, strict=True):
        if signal is not None:
            row[:-1], row[-1] = signal, signal[-1]
    return out


def along(on: SimulatedTwist, by: LoopDrive, elements: Sequence[Element]) -> Array:
    """(n * times,) torque of elements on a simulated twist."""
    return twist.followed(packed(elements), by.twist_rad, by.rate_rad_s, on.load)


def remembers(effect: Effect) -> bool:
    """Whether its torque depends on the path of the twist, so that only a loop over the samples gives it."""
    return any(element.kind >= STOP for element in effect.law)


def remembered(effect: Effect, motion: Motion, shape: Mapping[str, float], came: float = 0.0) -> Array:
    """(n, k) the columns of such an effect from the start of a motion, compiled: a tenth of the time."""
    return np.stack([made_by(effect, motion, shape, unit, came) for unit in np.eye(len(effect.amplitudes))], axis=1)


def made_by(effect: Effect, motion: Motion, shape: Mapping[str, float], amplitudes: Array, came: float) -> Array:
    """(n,) torque of such an effect along a motion whose twist had `came` so far one way before."""
    assert effect.in_loop is not None
    law, load = packed(effect.in_loop(shape, amplitudes.tolist())), np.abs(motion.torque_Nm)
    return twist.followed(law, motion.twist_rad, motion.twist_rate_rad_s, load, came)


def packed(elements: Sequence[Element]) -> Array:
    """(e, 5) for the compiled loop."""
    return np.array(elements, dtype=float).reshape(-1, 5)


def filtered(trial: PreparedMotion, fine: Array, times: int) -> Array:
    """(m,) of a torque at the substep rate through the balance filter, at the rows of the trial."""
    n = len(fine) // times
    length = fft.next_fast_len(n + 2 * trial.fir.delay, real=True)
    kernel = np.zeros(length)
    kernel[: trial.fir.delay + 1] = trial.fir.value[trial.fir.delay :]
    kernel[-trial.fir.delay :] = trial.fir.value[: trial.fir.delay]
    gain = fft.rfft(kernel).real
    spectrum = fft.rfft(fine, length * times)[: len(gain)] * gain
    smooth: Array = fft.irfft(spectrum, length) / times
    return smooth[trial.rows]

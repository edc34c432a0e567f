"""Friction simulated in the loop: the twist rate that the encoders are too coarse to show.

Where friction holds the twist still, its torque follows from the balance, not from the measured rate. So the torsion
is integrated with the friction law in it, driven by the measured input, and held near the measured twist by an
observer whose injection only adds damping to its error. The rule is the implicit midpoint rule (Hairer, Lubich & Wanner
2006, Geometric Numerical Integration, II.1): one scalar equation a step, solved by Newton's method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import fft

from edge_daemon.estimate.kinematics import FirSet, filters
from edge_daemon.records import Array, Motion

SUBSTEP_RATE_HZ = 4000.0
"""four steps within the millisecond or two in which friction turns round"""
INJECTION = 1.0
"""observer injection over the torsional resonance [rad/s]: damping ratio 0.5 of the observer's error"""
NEWTON_STEPS = 12
RATE_TOLERANCE = 1e-3
"""last Newton step over the smoothing speed; the next would be a thousandth of it"""
SATURATED = 9.0
"""rate over smoothing speed beyond which the sign is one to 3e-8"""


@dataclass(frozen=True, slots=True)
class Spring:
    """The linear part: inertia [kg m^2], stiffness [N m/rad], damping [N m s/rad]."""

    inertia: float
    stiffness: float
    damping: float


@dataclass(frozen=True, slots=True)
class Law:
    """tanh(v / smoothing) * (level + excess exp(-(v / stribeck_speed)^2) + coefficient |torque|)."""

    level: float = 0.0
    excess: float = 0.0
    coefficient: float = 0.0
    smoothing: float = 1e-3
    stribeck_speed: float = 1.0


def refine(motion: Motion) -> int:
    """Substeps per sample."""
    return max(1, round(SUBSTEP_RATE_HZ / motion.rate_hz))


def upsampled(signal: Array, times: int) -> Array:
    """(n * times,) band-limited interpolation; a straight line through the ends is taken out before."""
    n = len(signal)
    if times == 1:
        return signal
    at = np.arange(n * times) / times
    slope = (signal[-1] - signal[0]) / (n - 1)
    spectrum = fft.rfft(signal - signal[0] - slope * np.arange(n))
    fine: Array = fft.irfft(spectrum, n * times) * times + signal[0] + slope * at
    return fine


def slope_of(signal: Array, rate_hz: float) -> Array:
    """(n,) band-limited time derivative; a straight line through the ends is taken out before."""
    n = len(signal)
    slope = (signal[-1] - signal[0]) / (n - 1)
    spectrum = fft.rfft(signal - signal[0] - slope * np.arange(n))
    omega = 2j * np.pi * fft.rfftfreq(n, 1 / rate_hz)
    derivative: Array = fft.irfft(spectrum * omega, n) + slope * rate_hz
    return derivative


def fine_filter(motion: Motion, fir: FirSet) -> FirSet:
    """The balance filter at the substep rate: the same kernel, sampled more finely."""
    return filters(motion.rate_hz * refine(motion), fir.cutoff_hz)


def settled(motion: Motion, spring: Spring, law: Law, extra_Nm: Array) -> Motion:
    """The motion at the substep rate, with twist and twist rate as the loop gives them.

    `extra_Nm` (n,) is what further effects add to the torque of the gear on the output.
    """
    times = refine(motion)
    h = 1 / (motion.rate_hz * times)
    speed = motion.velocity_out_rad_s + motion.twist_rate_rad_s
    u2 = upsampled(slope_of(speed, motion.rate_hz), times)
    push = spring.inertia * u2 - upsampled(extra_Nm, times)
    torque = upsampled(motion.torque_Nm, times)
    level = law.level + law.coefficient * np.abs(torque)
    twist, rate = _integrate(h, spring, law, push, level, upsampled(motion.twist_rad, times))
    fine: dict[str, Any] = {name: np.repeat(getattr(motion, name), times) for name in _HELD}
    return replace(
        motion, rate_hz=motion.rate_hz * times, time_s=motion.time_s[0] + h * np.arange(len(twist)), twist_rad=twist,
        twist_rate_rad_s=rate, torque_Nm=torque, extra={}, **fine,
    )  # fmt: skip


_HELD = (
    "theta_in_rad",
    "theta_out_rad",
    "velocity_out_rad_s",
    "acceleration_out_rad_s2",
    "temperature_degC",
)
"""what no friction law looks at: held from sample to sample"""


def _integrate(h: float, spring: Spring, law: Law, push: Array, level: Array, seen: Array) -> tuple[Array, Array]:
    """Twist and twist rate in the middle of each substep, which is where `push`, `level` and `seen` are given."""
    k, half = spring.stiffness, h / 2
    mass = 2 * spring.inertia / h
    gain = mass + spring.damping + half * k
    pull = INJECTION * math.sqrt(k / spring.inertia) * h
    s, vs, excess = 1 / law.smoothing, 1 / law.stribeck_speed, law.excess
    near = RATE_TOLERANCE * law.smoothing
    tanh, atanh, exp = math.tanh, math.atanh, math.exp
    phi, v, m = float(seen[0]), 0.0, 0.0
    twists, rates = [], []
    for force, f, target in zip(push.tolist(), level.tolist(), seen.tolist(), strict=True):
        phi += pull * (target - phi - half * m)
        known = mass * v - k * phi + force
        low, high = -math.inf, math.inf
        size = f + (excess * exp(-((m * vs) ** 2)) if excess and abs(m * vs) < 6 else 0.0)
        if known > size:
            m = (known - size) / gain
        elif known < -size:
            m = (known + size) / gain
        else:
            m = atanh(0.999 * known / size) / s if size else known / gain
        slides = not excess and (m * s > SATURATED or m * s < -SATURATED)
        for _ in range(0 if slides else NEWTON_STEPS):
            t = tanh(m * s)
            bump = excess * exp(-((m * vs) ** 2)) if excess and abs(m * vs) < 6 else 0.0
            size = f + bump
            over = gain * m + size * t - known
            if over > 0:
                high = m
            else:
                low = m
            slope = gain + size * s * (1 - t * t) - 2 * m * vs * vs * bump * t
            step = over / slope if slope > 0.1 * gain else over / gain
            following = m - step
            if not low <= following <= high:
                following = 0.5 * (low + high) if math.isfinite(low + high) else m - 0.5 * step
            step, m = following - m, following
            if -near < step < near:
                break
        twists.append(phi + half * m)
        rates.append(m)
        phi += h * m
        v = 2 * m - v
    return np.array(twists), np.array(rates)

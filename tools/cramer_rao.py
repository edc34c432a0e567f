"""Cramer-Rao bounds of a simulated joint, from nothing but the simulation and the encoders' steps.

The joint answers the true motor angle u by theta_out = G(u), and both are read with white noise. Below the frequency up
to which it may move the motor angle is unknown sample by sample; eliminated, it leaves theta_out - G(theta_in) with the
spectrum S = s_out^2 + |H|^2 s_in^2, H the answer of spring and damper to small angles: near its resonance the joint
magnifies the noise of the motor's encoder. Above that frequency the motor is known to be still, its encoder's noise is
told from motion, and S = s_out^2. The derivative d of the answer to each parameter is a difference of two simulations.
sd = root of the diagonal of the inverse Fisher matrix sum_f d(f) d(f)* / S(f) (Whittle's; Kay, Fundamentals of
Statistical Signal Processing, 1993, section 3.9), with the encoders' zero and the orders 1, 2, 4 of kinematic error
unknown as well, and on request the twist rate within which friction turns round: an estimate that frees that width is
held against a bound that does so too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.motion import simulated_joint as rig

STEP = 0.01
"""relative, of each difference to either side"""
WAVE_RAD = 1e-6
ORDERS = (1, 2, 4)
MOTOR_HZ = 100.0
"""up to which the motor may move, where nothing else is said: the cut-off of the balance"""
Simulate = Callable[[rig.Joint, rig.Path], tuple[np.ndarray, np.ndarray]]


def steps_rad(joint: rig.Joint) -> tuple[float, float]:
    """sd of the rounding of both encoders as it stands at the output: motor, output."""
    into, out = 2 * math.pi / 2**joint.in_bits / joint.ratio, 2 * math.pi / 2**joint.out_bits
    return into / math.sqrt(12), out / math.sqrt(12)


def noise_rad(joint: rig.Joint) -> float:
    """sd of the encoders' rounding as it stands in the twist; below a tenth of the resonance both count alike."""
    return math.hypot(*steps_rad(joint))


def spectrum(joint: rig.Joint, frequency_hz: np.ndarray, motor_hz: float) -> np.ndarray:
    """(f,) variance that the noise has at each frequency, per sample [rad^2]."""
    into, out = steps_rad(joint)
    w = 2 * math.pi * frequency_hz
    spring = joint.stiffness + 1j * w * joint.damping
    answer = np.abs(spring / (spring - joint.inertia * w**2))
    return out**2 + np.where(frequency_hz < motor_hz, (answer * into) ** 2, 0.0)


def derivatives(joint: rig.Joint, path: rig.Path, simulate: Simulate, width: bool = False) -> dict[str, np.ndarray]:
    """Name -> (n,) change of theta_out per unit of each parameter."""

    def answer(other: rig.Joint) -> np.ndarray:
        return simulate(other, path)[1]

    def slope(name: str) -> np.ndarray:
        step = STEP * getattr(joint, name)
        up, down = (replace(joint, **{name: getattr(joint, name) + sign * step}) for sign in (1, -1))
        return (answer(up) - answer(down)) / (2 * step)

    dry = ("coulomb", "reversal") if width else ("coulomb",)
    names = ("stiffness", "damping", *(dry if joint.coulomb else ()))
    rows = {name: slope(name) for name in names}
    for order in ORDERS:
        for word, pair in (("sine", (WAVE_RAD, 0.0)), ("cosine", (0.0, WAVE_RAD))):
            up, down = (replace(joint, waves=((order, sign * pair[0], sign * pair[1]),)) for sign in (1, -1))
            rows[f"{word}_{order}"] = (answer(up) - answer(down)) / (2 * WAVE_RAD)
    rows["zero"] = np.ones_like(rows["stiffness"])
    rows["ratio"] = -rig.linear(replace(joint, kinematic_pp=0.0), path)[1] / joint.ratio
    return rows


def covariance_of(columns: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(q, q) least covariance of what (n, q) columns belong to, in noise of a spectrum (n // 2 + 1,) per sample."""
    n, scale = len(columns), np.linalg.norm(columns, axis=0)
    waves = np.fft.rfft(columns / scale, axis=0) / np.sqrt(variance)[:, None]
    both_sides = np.where(np.arange(len(waves)) % (n / 2) == 0, 1.0, 2.0)
    fisher = np.real((waves.conj() * both_sides[:, None]).T @ waves) / n
    return np.linalg.inv(fisher) / np.outer(scale, scale)


def bounds(
    joint: rig.Joint,
    path: rig.Path,
    simulate: Simulate = rig.linear,
    width: bool = False,
    motor_hz: float = MOTOR_HZ,
) -> dict[str, float]:
    """Least sd of an unbiased estimate: stiffness, damping, coulomb, ratio, and peak to peak of the kinematic error;
    with `width`, the friction's is unknown and bounded as well, as `reversal`; the motor moves below `motor_hz`."""
    rows = derivatives(joint, path, simulate, width)
    columns = np.column_stack(list(rows.values()))
    frequency = np.fft.rfftfreq(len(columns), 1 / rig.RATE_HZ)
    covariance = covariance_of(columns, spectrum(joint, frequency, motor_hz))
    names = list(rows)
    sd = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    at = np.linspace(0.0, 2 * math.pi, 2001)
    course = rig.kinematic(joint, at)
    top, bottom = (at[pick(course)] for pick in (np.argmax, np.argmin))
    spread = np.zeros(len(names))
    for i, name in enumerate(names):
        if name.startswith(("sine", "cosine")):
            wave, order = (np.sin if name[0] == "s" else np.cos), int(name[-1])
            spread[i] = wave(order * top) - wave(order * bottom)
    sd["kinematic_error"] = float(np.sqrt(spread @ covariance @ spread))
    wanted = ("stiffness", "damping", "coulomb", "reversal", "ratio", "kinematic_error")
    return {name: float(sd[name]) for name in wanted if name in sd}

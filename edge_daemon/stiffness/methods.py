"""Three ways to measure the torsional stiffness, each with its uncertainty and the limits of its own kind.

static: hold torques, or turn them round slowly, and read the deflection at rest. Simple and clear; misses whatever
depends on speed, is blurred by hysteresis, and is slow.
frequency response: torque over twist at the frequencies of a vibration, amplitude and phase. Shows what depends on
frequency; wants coherent excitation and reads every resonance as stiffness.
dynamic: a model fitted to any motion. Works in place; as good as the inertia and the encoders are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import Fitted, fit
from edge_daemon.motion.kinematics import motion_of, uniform
from edge_daemon.motion.spectral_lines import MethodError, lines_of, longest
from edge_daemon.records import Array, Mask, Motion
from edge_daemon.text import number

Method = Literal["static", "frequency-response", "dynamic"]
METHODS: tuple[Method, ...] = get_args(Method)

HOLD_S = 0.1
"""Deflection and torque are averaged over this long."""
STEADY_SHARE = 0.02
"""A stretch counts as steady where torque changes by less than this of its range between its halves."""
SETTLE_HOLDS = 3
"""So many stretches are left out after a step of torque: three tenths of a second let the output ring down."""
BEFORE_HALVES = 2
"""So many half stretches are left out before a step, where the filter already feels it."""
LEVELS = 40
"""Torques that differ by less than a fortieth of the range are one level."""
SAME_RAD = 1e-12
"""Angles closer than this are one value, written twice."""
LEAST_HOLDS = 12
WAYS_APART = 3.0
"""A direction term of this many of its sd is hysteresis."""
LOOP_SHARE = 0.005
"""... that matters from this share of the deflection (guess)"""
GOOD_COHERENCE = 0.95
NOISE_SHARE = 0.1
"""The dynamic method is called noisy from this share of encoder noise in the balance (guess)."""
MISSES_DYNAMICS = "misses dynamic effects"
AGREE_SD = 3.0
"""Methods whose values lie within this many of their joint sd agree."""


@dataclass(frozen=True, slots=True)
class MethodLimit:
    """One stated limit of a method, checked on this recording."""

    name: str
    kept: bool
    """True: it does no harm here"""
    detail: str


@dataclass(frozen=True, slots=True)
class StiffnessMeasurement:
    """What one method found."""

    method: Method
    stiffness_Nm_per_rad: float
    sd_Nm_per_rad: float
    """includes the uncertainty of the inertia where that makes the torque"""
    random_sd_Nm_per_rad: float
    """from scatter alone: what two methods on one inertia may differ by"""
    limits: tuple[MethodLimit, ...]
    details: Mapping[str, float]
    """further figures by name, unit in the name"""


@dataclass(frozen=True, slots=True)
class MethodComparison:
    """Methods side by side."""

    pairs: tuple[tuple[Method, Method, float], ...]
    """(a, b, difference a - b in joint sd)"""
    agree: bool
    verdict: str
    passed: tuple[str, ...] = ()
    """which stated limit of which method this motion and gear pass, `method: limit`"""


def measure(
    method: Method,
    time_s: Array,
    columns: Mapping[str, Array],
    ratio: float,
    inertia_kg_m2: float,
    inertia_sd_kg_m2: float = 0.0,
    effects: Sequence[ModelEffect] = (),
) -> StiffnessMeasurement:
    """The stiffness at the output by one method. `columns` as in a recording; torque is `torque_out_Nm` where given,
    else inertia times acceleration. `effects`: what the gear is known to have, which only the dynamic method can tell
    from the stiffness. Raises `BadInput`."""
    blur = 0.0 if "torque_out_Nm" in columns else inertia_sd_kg_m2 / inertia_kg_m2
    if method == "static":
        return _static(time_s, columns, ratio, inertia_kg_m2)
    if method == "frequency-response":
        return _frequency_response(time_s, columns, ratio, inertia_kg_m2, blur)
    if method == "dynamic":
        return _dynamic(time_s, columns, Model("torsion", ratio, inertia_kg_m2, tuple(effects)), blur)
    raise MethodError(f"method {method!r}: expected one of {', '.join(METHODS)}")


def compare_methods(found: Sequence[StiffnessMeasurement]) -> MethodComparison:
    """Whether measurements agree within their stated uncertainty, and what a disagreement says."""
    pairs = []
    for a, b in combinations(found, 2):
        apart = a.stiffness_Nm_per_rad - b.stiffness_Nm_per_rad
        pairs.append((a.method, b.method, apart / math.hypot(a.sd_Nm_per_rad, b.sd_Nm_per_rad)))
    agree = all(abs(z) <= AGREE_SD for _, _, z in pairs)
    passed = _passed(found, {frozenset((a, b)): z for a, b, z in pairs})
    words = "the methods agree within their uncertainty" if agree else _why(found)
    verdict = words + (f"; limits passed: {', '.join(passed)}" if passed else "")
    return MethodComparison(tuple(pairs), agree, verdict, passed)


def _why(found: Sequence[StiffnessMeasurement]) -> str:
    by = {row.method: row.stiffness_Nm_per_rad for row in found}
    static, moving = by.get("static"), [value for name, value in by.items() if name != "static"]
    if static is None:
        return "the methods disagree: the gear's answer depends on frequency or amplitude"
    if all(value > static for value in moving):
        return "softer at rest than in motion: something depends on speed, which the static method cannot see"
    if all(value < static for value in moving):
        return "stiffer at rest than in motion: friction holds at rest, or the configured inertia is too small"
    return "the methods disagree in both directions: look at their limits first"


def _passed(found: Sequence[StiffnessMeasurement], apart: Mapping[frozenset[Method], float]) -> tuple[str, ...]:
    """The limits of article 2's table that are passed: those each method saw on its own recording, and that of the
    static method, which none of its own data can show: every method that moves tells otherwise than it."""
    moving = [abs(z) for pair, z in apart.items() if "static" in pair]
    blind = [f"static: {MISSES_DYNAMICS}"] if moving and min(moving) > AGREE_SD else []
    return (*blind, *(f"{row.method}: {limit.name}" for row in found for limit in row.limits if not limit.kept))


def _motion(time_s: Array, columns: Mapping[str, Array], ratio: float, inertia: float) -> tuple[Motion, Mask]:
    rate = 1 / float(np.median(np.diff(time_s)))
    return motion_of(uniform(time_s, columns), ratio, inertia, min(100.0, 0.16 * rate))


# ---- static


def _static(time_s: Array, columns: Mapping[str, Array], ratio: float, inertia: float) -> StiffnessMeasurement:
    if "torque_out_Nm" not in columns:
        raise MethodError("static: torque_out_Nm: missing: at rest inertia makes no torque, so it must be measured")
    motion, valid = _motion(time_s, columns, ratio, inertia)
    size = max(2, round(HOLD_S * motion.rate_hz) // 2 * 2)
    count = len(motion) // size
    torque, twist, way = (_means(x, size) for x in (motion.torque_Nm, motion.twist_rad, _way(motion, size)))
    orders = _orders(motion, size)
    whole = valid[: count * size].reshape(count, size).all(axis=1)
    kept = whole & _steady(motion.torque_Nm, size)
    if kept.sum() < LEAST_HOLDS or np.ptp(torque[kept]) == 0:
        raise MethodError(f"static: {int(kept.sum())} steady stretches of torque: expected at least {LEAST_HOLDS}")
    design = np.column_stack([torque, np.ones(count), *([way] if np.ptp(way[kept]) else []), *orders])[kept]
    solved, sd = _least_squares(design, twist[kept], _groups(torque[kept]))
    stiffness = 1 / solved[0]
    resting_rad = _step_error_rad(columns["theta_out_rad"], motion, size)
    spread = stiffness**2 * math.hypot(sd[0], resting_rad / float(torque[kept].std()))
    width = 2 * abs(solved[2]) if np.ptp(way[kept]) else 0.0
    deflection = float(np.ptp(torque[kept])) / stiffness
    seen = bool(width > LOOP_SHARE * deflection and width > 2 * WAYS_APART * sd[2])
    limits = (
        MethodLimit(MISSES_DYNAMICS, True, "holds at rest only; compare with a method that moves"),
        MethodLimit(
            "hysteresis losses", not seen, f"loop {width:.3g} rad wide, {width / deflection:.2%} of the deflection"
        ),
        MethodLimit("slow", True, f"{kept.mean():.0%} of {time_s[-1] - time_s[0]:.3g} s was steady enough to use"),
    )
    details = {
        "hysteresis_rad": float(width),
        "holds": float(kept.sum()),
        "torque_range_Nm": float(np.ptp(torque[kept])),
    }
    return StiffnessMeasurement("static", stiffness, spread, spread, limits, details)


def _means(values: Array, size: int) -> Array:
    count = len(values) // size
    means: Array = values[: count * size].reshape(count, size).mean(axis=1)
    return means


def _steady(torque: Array, size: int) -> Mask:
    """(m,) True for stretches whose torque hardly changes, nor did just before or does just after: no echo."""
    halves = _means(torque, size // 2)
    jumps = np.abs(np.diff(halves, prepend=halves[0])) >= STEADY_SHARE * np.ptp(torque)
    reach = np.ones(2 * SETTLE_HOLDS + BEFORE_HALVES)
    unrest = np.convolve(jumps, reach)[BEFORE_HALVES : BEFORE_HALVES + len(jumps)] > 0.5
    count = len(torque) // size
    calm: Mask = np.logical_not(unrest[: 2 * count].reshape(count, 2).max(axis=1))
    return calm


def _way(motion: Motion, size: int) -> Array:
    """(n,) +1 or -1: which way the torque last went by more than noise; 0 before the first."""
    level = np.repeat(_means(motion.torque_Nm, size), size)
    change = np.diff(level, prepend=level[0])
    change[np.abs(change) < STEADY_SHARE / 8 * np.ptp(level)] = 0.0
    last = np.maximum.accumulate(np.where(change != 0, np.arange(len(level)), 0))
    way = np.sign(change[last])
    return np.concatenate((way, np.full(len(motion) - len(way), way[-1])))


def _orders(motion: Motion, size: int) -> list[Array]:
    """The kinematic error's columns, averaged as the rest is; none while the motor hardly turns."""
    angle = motion.theta_in_rad
    if np.ptp(angle) < 2 * math.pi:
        return []
    return [_means(wave(order * angle), size) for order in MOTOR_ORDERS for wave in (np.sin, np.cos)]


def _step_error_rad(raw: Array, motion: Motion, size: int) -> float:
    """Error of a resting output encoder that no averaging removes; 0 where it moves by steps within a stretch.

    Over evenly spaced levels that error may run along with the torque, and then nothing in the residuals tells: its
    amplitude counts. Noise before rounding shrinks it: first harmonic of the saw tooth (Widrow & Kollar
    2008, "Quantization Noise").
    """
    flicker = np.diff(raw[np.isfinite(raw)])
    changes = np.abs(flicker)[np.abs(flicker) > SAME_RAD]
    if not len(changes):
        return 0.0
    step = float(changes.min())
    travel = np.abs(np.diff(_means(motion.theta_out_rad, size)))
    if float(np.median(travel)) > step / 2:
        return 0.0
    noise = float(np.median(_means((flicker / step) ** 2, size))) / 2  # the median stretch is free of motion
    before = max(noise - 1 / 12, 0.0)
    return step * min(1 / math.sqrt(12), math.exp(-2 * math.pi**2 * before) / math.pi)


def _least_squares(design: Array, target: Array, group: NDArray[np.intp]) -> tuple[Array, Array]:
    """Coefficients and sd. Residuals of one group may hang together in any way, as the encoder's step error does at
    one level (sandwich, Liang & Zeger 1986)."""
    solved, *_ = np.linalg.lstsq(design, target, rcond=None)
    scores = design * (target - design @ solved)[:, None]
    count = int(group.max()) + 1
    sums = np.zeros((count, design.shape[1]))
    np.add.at(sums, group, scores)
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-13, hermitian=True)
    factor = count / max(1, count - design.shape[1])
    sd: Array = np.sqrt(np.diagonal(inverse @ (sums.T @ sums) @ inverse) * factor)
    return np.asarray(solved, dtype=np.float64), sd


def _groups(torque: Array) -> NDArray[np.intp]:
    """(m,) number of the torque level that each stretch belongs to: at one level the encoder stands at one place, and
    errs alike however often it comes back."""
    level = np.rint((torque - torque.min()) / np.ptp(torque) * LEVELS)
    return np.unique(level, return_inverse=True)[1].astype(np.intp)


# ---- frequency response


def _frequency_response(
    time_s: Array, columns: Mapping[str, Array], ratio: float, inertia: float, blur: float
) -> StiffnessMeasurement:
    motion, valid = _motion(time_s, columns, ratio, inertia)
    inside = longest(valid)
    lines = lines_of(motion.torque_Nm[inside], _without_orders(motion)[inside], motion.rate_hz)
    weight = 1 / lines.sd**2
    stiffness = float(weight @ lines.stiffness.real / weight.sum())
    # lines that disagree by more than their sd scatter for another reason: it belongs into the uncertainty
    scatter = float(weight @ (lines.stiffness.real - stiffness) ** 2) / max(1, len(weight) - 1)
    random = math.sqrt(max(1.0, scatter if len(weight) > 1 else 1.0) / weight.sum())
    coherence = float(lines.coherence.min())
    low, high = (float(lines.stiffness.real[i]) for i in (0, -1))
    apart = abs(high - low) / math.hypot(float(lines.sd[0]), float(lines.sd[-1])) if len(weight) > 1 else 0.0
    band = f"{lines.frequency_hz[0]:.3g} to {lines.frequency_hz[-1]:.3g} Hz"
    limits = (
        MethodLimit(
            "requires a shaker", coherence >= GOOD_COHERENCE, f"the motor shook {band}, coherence {coherence:.3f}"
        ),
        MethodLimit(
            "complex analysis",
            apart <= AGREE_SD,
            f"{number(low)} N m/rad at the lowest line, {number(high)} at the highest",
        ),
    )
    omega = 2 * math.pi * lines.frequency_hz
    damping = float(weight @ (lines.stiffness.imag / omega) / weight.sum())
    details = {"damping_Nms_per_rad": damping, "coherence": coherence, "lines": float(len(weight))}
    details |= {"lowest_Nm_per_rad": low, "highest_Nm_per_rad": high}
    sd = math.hypot(random, blur * stiffness)
    return StiffnessMeasurement("frequency-response", stiffness, sd, random, limits, details)


def _without_orders(motion: Motion) -> Array:
    """(n,) the twist less the kinematic error: a shaking motor repeats it at the very lines of its torque, so that no
    average removes it and the coherence does not show it."""
    orders = _orders(motion, 1)
    if not orders:
        return motion.twist_rad
    design = np.column_stack([motion.torque_Nm, motion.twist_rate_rad_s, np.ones(len(motion)), *orders])
    whole = np.isfinite(design).all(axis=1) & np.isfinite(motion.twist_rad)
    solved, *_ = np.linalg.lstsq(design[whole], motion.twist_rad[whole], rcond=None)
    less: Array = motion.twist_rad - design[:, 3:] @ solved[3:]
    return less


# ---- dynamic identification


@dataclass(frozen=True, slots=True)
class _Record:
    """What `fit` takes."""

    time_s: Array
    columns: Mapping[str, Array]


STIFFNESS, DAMPING = "linear_stiffness", "viscous_damping"
PARTS = (STIFFNESS, DAMPING, "kinematic_error")
"""Every gear has these; left out, the kinematic error leaks into the stiffness."""


def _dynamic(time_s: Array, columns: Mapping[str, Array], model: Model, blur: float) -> StiffnessMeasurement:
    more = (ModelEffect(name) for name in PARTS if model.effect(name) is None)
    fitted = fit([_Record(time_s, columns)], replace(model, effects=(*model.effects, *more)))
    known = {row.name: row.parameters for row in fitted.model.effects}
    parameter = known[STIFFNESS]["stiffness"]
    noise = fitted.floor / fitted.problem.rms
    torque = (
        "a torque sensor"
        if "torque_out_Nm" in columns
        else f"inertia {model.output_inertia_kg_m2:g} kg m2 known to {blur:.2%}"
    )
    limits = (
        MethodLimit("accurate load inertia", blur * parameter.value <= parameter.sd, f"torque from {torque}"),
        MethodLimit("measurement noise", noise <= NOISE_SHARE, f"encoder noise is {noise:.2%} of the torque"),
        MethodLimit("the model is complete", _complete(fitted), f"held-out error {fitted.nrmse:.2%} of the torque"),
    )
    sd = math.hypot(parameter.sd, blur * parameter.value)
    damping = known[DAMPING]["damping"].value
    details = {"damping_Nms_per_rad": damping, "nrmse": fitted.nrmse, "noise_floor_nrmse": noise}
    return StiffnessMeasurement("dynamic", parameter.value, sd, parameter.sd, limits, details)


def _complete(fitted: Fitted) -> bool:
    """Whether what is left is little more than sensor noise (twice its rms: other parts of the daemon judge finer)."""
    return fitted.nrmse * fitted.problem.rms <= 2 * fitted.floor

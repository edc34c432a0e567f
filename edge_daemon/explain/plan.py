"""The next experiment: a motion on which two explanations that fit equally well would come apart.

Candidate motions are tones within the limits. The first explanation is played through each by inverse dynamics: the
output motion is prescribed, the twist solved from the balance, the encoders read with the noise of the recording. The
second explanation is then fitted to it; what it leaves over the noise floor is the predicted separation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from edge_daemon.balance.preparation import prepare
from edge_daemon.effects.model import Model
from edge_daemon.errors import BadInput
from edge_daemon.explain.results import Experiment
from edge_daemon.identify.fit import floor_of
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution
from edge_daemon.motion.kinematics import filters
from edge_daemon.records import Array, Motion
from edge_daemon.search.hypotheses import Hypothesis, parted_by

RATE_HZ = 1000.0
SECONDS = 12.0
"""The prediction simulates so long a motion."""
ADVISED_SECONDS = 30.0
ROUNDS = 8
"""The implicit twist is repeated so often; friction and springs settle within a few."""
SEED = 5
LEAD_S = 1.0
TORQUE_TIMES = 3.0
"""A proposed motion has at most this many times the largest torque of the recording (guess: a first recording is a
careful one)."""
RUNAWAY_TWIST_RAD = 0.05
"""No flexspline twists further: a repetition that gets there has run away."""


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """What a test motion must keep within."""

    motor_speed_rad_s: float = 314.0
    """3000 rpm, what the makers' tables rate continuously at grease lubrication"""
    torque_Nm: float = math.inf
    travel_rad: float = 1.5
    """output, to either side"""
    tone_hz: float = math.inf
    """what the drive is led by draws no faster tone"""


MenuRow = tuple[str, tuple[float, ...], tuple[float, ...]]
"""Words, tones [Hz], and the relative speed of each."""
MENU: tuple[MenuRow, ...] = (
    ("tones from slow to fast, at about equal speeds", (0.31, 1.27, 3.7, 7.9, 13.1, 21.3), (1, 1, 1, 1, 1, 1)),
    ("fast tones for large torque over a slow one", (0.23, 7.9, 13.1, 19.3), (0.5, 1, 1, 1)),
    ("slow and wide, with little inertia torque", (0.11, 0.37, 1.3), (1, 1, 1)),
)


def next_experiment(
    model: Model, problem: RegressionProblem, one: Hypothesis, other: Hypothesis, limits: MotionLimits | None = None
) -> Experiment | None:
    """The motion of the menu that separates two explanations best; None for a drive balance or where none can be
    computed. `separation` above 2 means that the wrong one would be seen to fail."""
    if model.balance != "torsion" or not math.isfinite(model.output_inertia_kg_m2):
        return None
    if not one.solution.amplitude(*STIFFNESS) > 0:
        return None
    limits = within(limits, limits_of(problem))
    tried = [_tried(model, problem, (one, other), row, limits) for row in MENU]
    known = [experiment for experiment in tried if experiment is not None]
    best = max(known, key=lambda experiment: experiment.separation, default=None)
    change = parted_by(one, other)
    if best is None or not change:
        return best
    return replace(best, motion=f"{change}; motion: {best.motion}", needs_hands=True)


def richest(model: Model, problem: RegressionProblem, limits: MotionLimits | None = None) -> Experiment | None:
    """The motion of most tones, for a recording that has too few to judge any cause by; None where the load is not
    known."""
    if not math.isfinite(model.output_inertia_kg_m2):
        return None
    return planned(model.output_inertia_kg_m2, model.ratio, (), MENU[0], within(limits, limits_of(problem)))


def within(given: MotionLimits | None, seen: MotionLimits) -> MotionLimits:
    """What keeps the limits that are given, and with them what a recording calls for."""
    if given is None:
        return seen
    return MotionLimits(*(min(getattr(given, row.name), getattr(seen, row.name)) for row in fields(MotionLimits)))


def limits_of(problem: RegressionProblem) -> MotionLimits:
    """Rated speed, three times the torque and twice the travel that the recordings show."""
    motions = [trial.motion for trial in problem.trials]
    speed = max(float(np.abs(motion.velocity_out_rad_s * motion.ratio).max()) for motion in motions)
    travel = max(float(np.ptp(motion.theta_out_rad)) for motion in motions)
    torque = float(np.abs(problem.target).max())  # filtered: at the ends and between noise there is more
    return MotionLimits(max(314.0, speed), TORQUE_TIMES * torque, max(1.5, travel))


def _tried(
    model: Model,
    problem: RegressionProblem,
    pair: tuple[Hypothesis, Hypothesis],
    row: MenuRow,
    limits: MotionLimits,
) -> Experiment | None:
    one, other = pair
    plan = planned(model.output_inertia_kg_m2, model.ratio, (one.name, other.name), row, limits)
    with np.errstate(over="ignore", invalid="ignore"):
        time_s, columns = played(model, problem, one.solution, plan.tones_hz, plan.speeds_in_rad_s)
    twist = columns["theta_in_rad"] / model.ratio - columns["theta_out_rad"]
    if not float(np.abs(twist).max()) < RUNAWAY_TWIST_RAD:
        return None  # beyond the torque that was seen a fitted law may have no twist at all
    try:
        trial = prepare(time_s, columns, model)
    except BadInput:
        return None
    there = RegressionProblem([trial])
    there.learn(other.solution)
    wrong = there.fit(other.solution.terms, rounds=2)
    there.learn(one.solution)
    right = there.fit(one.solution.terms, rounds=2)
    wrong_floor, right_floor = (max(floor_of(there, model, solution), 1e-12) for solution in (wrong, right))
    return replace(plan, separation=(wrong.rmse / wrong_floor) / max(right.rmse / right_floor, 1.0))


def planned(
    inertia_kg_m2: float, ratio: float, separates: tuple[str, ...], row: MenuRow, limits: MotionLimits
) -> Experiment:
    """A motion of the menu, as large as the limits allow."""
    words, tones, weights = row
    kept = [k for k, tone in enumerate(tones) if tone <= limits.tone_hz]
    tones, weights = tuple(tones[k] for k in kept), tuple(weights[k] for k in kept)
    speeds = speeds_within(tones, weights, inertia_kg_m2, abs(ratio), limits)
    return Experiment(
        separates=separates,
        motion=words,
        tones_hz=tones,
        speeds_in_rad_s=tuple(round(speed, 3) for speed in speeds),
        seconds=ADVISED_SECONDS,
        separation=math.nan,
        limits={
            "motor_speed_rad_s": limits.motor_speed_rad_s,
            "torque_Nm": limits.torque_Nm,
            "travel_rad": limits.travel_rad,
        },
    )


def speeds_within(
    tones: tuple[float, ...], weights: tuple[float, ...], inertia: float, ratio: float, limits: MotionLimits
) -> tuple[float, ...]:
    """Motor speed amplitude of each tone, scaled so that peak speed, torque and travel are kept even when all peaks
    coincide."""
    w = 2 * math.pi * np.array(tones)
    share = np.array(weights, dtype=float)
    travel = float((share / w).sum()) / ratio
    torque = inertia * float((share * w).sum()) / ratio
    scale = min(limits.motor_speed_rad_s / share.sum(), limits.travel_rad / travel, limits.torque_Nm / torque)
    return tuple(float(value) for value in scale * share)


def played(
    model: Model, problem: RegressionProblem, solution: Solution, tones: tuple[float, ...], speeds: tuple[float, ...]
) -> tuple[Array, dict[str, Array]]:
    """Time and columns of a recording in which the solution holds exactly, up to the noise of the encoders."""
    t = np.arange(round((SECONDS + 2 * LEAD_S) * RATE_HZ)) / RATE_HZ
    out, speed, acceleration = (np.zeros(len(t)) for _ in range(3))
    for k, (tone, size) in enumerate(zip(tones, speeds, strict=True)):
        w, a, phase = 2 * math.pi * tone, size / abs(model.ratio), 2.4 * k
        out += a / w * np.sin(w * t + phase)
        speed += a * np.cos(w * t + phase)
        acceleration -= a * w * np.sin(w * t + phase)
    source = problem.trials[0].motion
    degc = source.temperature_degC
    warm = np.linspace(degc[0], degc[-1], len(t))
    motion = Motion(
        RATE_HZ, model.ratio, t, model.ratio * out, out, np.zeros(len(t)), np.zeros(len(t)), speed, acceleration,
        model.output_inertia_kg_m2 * acceleration, warm,
        {name: model.output_inertia_kg_m2 * acceleration for name in ("torque_out_Nm",) if name in source.extra},
    )  # fmt: skip
    twist = _twist(motion, solution, problem)
    noise = problem.trials[0].sensors
    rng = np.random.default_rng(SEED)
    columns = {
        "theta_in_rad": model.ratio * (out + twist) + rng.normal(0, noise.theta_in_rad or 1e-12, len(t)),
        "theta_out_rad": out + rng.normal(0, noise.theta_out_rad or 1e-12, len(t)),
    }
    if np.isfinite(warm).all():
        columns["temperature_degC"] = warm
    if "torque_out_Nm" in source.extra:
        columns["torque_out_Nm"] = motion.torque_Nm + rng.normal(0, problem.trials[0].sensors.torque or 1e-12, len(t))
    return t, columns


def _twist(motion: Motion, solution: Solution, problem: RegressionProblem) -> Array:
    """The twist as the encoders show it that balances the torque, by damped repetition."""
    stiffness, damping = solution.amplitude(*STIFFNESS), solution.amplitude(*DAMPING, 0.0)
    fir = filters(motion.rate_hz, 150.0)
    phi = motion.torque_Nm / stiffness
    for i in range(ROUNDS):
        smooth, rate = fir.apply(fir.value, phi), fir.apply(fir.first, phi)
        moved = replace(
            motion,
            theta_in_rad=motion.ratio * (motion.theta_out_rad + smooth),
            twist_rad=smooth,
            twist_rate_rad_s=rate,
        )
        further = np.zeros(len(phi))
        for term in solution.terms:
            if term.effect.name not in (STIFFNESS[0], DAMPING[0]):
                columns, _ = term.effect.columns(moved, problem.shapes(term.effect, _gentle(term.shapes)), None)
                further += columns @ solution.amplitudes[term.effect.name]
        wanted = (motion.torque_Nm - damping * rate - further) / stiffness
        phi += (1.0 if i == 0 else 0.6) * (wanted - phi)
    return phi


def _gentle(shapes: Mapping[str, float]) -> dict[str, float]:
    """Signs smooth enough for the repetition to settle."""
    return {name: max(value, 4e-3) if name == "smoothing" else value for name, value in shapes.items()}

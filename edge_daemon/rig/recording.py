"""Recordings of a simulated drive, with the truth beside them.

`simulate` makes one with named effects; `hidden` draws an effect from a seed and leaves it unnamed. Times are from 0,
angles multi-turn, in the columns of the product's recordings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.rig.motion import MOTIONS, Array, MotorMotion
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant, off_centre
from edge_daemon.rig.truths import OUTSIDE, REFERENCE_DEGC, ROWS, TRUTHS, Scale, Truth

LEAD_IN_S = 0.5
"""integrated before the recording starts, so that the start-up swing is gone"""
WARM_UP_K = 15.0
WARM_UP_S = 12.0
"""a small gear under load; quicker than life so that half a minute shows it (chosen)"""
ENCODER_NOISE_STEPS = 0.25
"""sd of an encoder's noise before rounding, in its steps (guess; also keeps rounding errors independent)"""
RATIO = 100.0
BASE = ("linear_stiffness", "viscous_damping")
"""always part of the simulated joint; may be named, adds nothing"""

Temperature = float | tuple[float, float]


class UnknownEffect(BadInput):
    """A name that the simulated drive does not have."""


@dataclass(frozen=True, slots=True)
class Simulated:
    """A recording and what is true about it."""

    time_s: Array
    columns: dict[str, Array]
    truth: dict[str, object]
    """`effects`, `parameters` (base and effects, `effect.name` -> SI value), `seed` and how it was recorded"""


def simulate(
    effects: Sequence[str] = (),
    seconds: float = 30.0,
    seed: int = 0,
    rate_hz: float = 1000.0,
    bits_in: int = 17,
    bits_out: int = 24,
    motion: str | MotorMotion = "rich",
    temperature: Temperature | None = None,
    parameters: Mapping[str, float] | None = None,
    balance: str = "torsion",
) -> Simulated:
    """A recording with the named effects, all of it drawn from `seed`.

    `temperature`: constant [degC], or (start, end) of a warm-up; by default 25, or a warm-up where an effect needs
    one. `parameters` overrides what would be drawn: `inertia_kg_m2`, `stiffness_Nm_per_rad`, `damping_Nms_per_rad`,
    `ratio`, or `effect.name` as in `truth["parameters"]`. `bits_*` = 0: no quantisation, no noise. `outside` means one
    of the effects that no catalogue lists, `hysteresis` one of the two kinds. Raises `UnknownEffect`, and
    `BadInput` for an unknown parameter or a rate that does not divide 8 kHz.
    """
    if balance == "drive":
        from edge_daemon.rig.drive_truth import simulate_drive

        return simulate_drive(effects, seconds, seed, rate_hz, bits_out, motion, temperature, parameters or {})
    given = dict(parameters or {})
    rng = np.random.default_rng(seed)
    joint = _joint(rng, given)
    course_of = MOTIONS[motion](seconds, rng) if isinstance(motion, str) else motion
    truths = [_truth(name, rng) for name in effects if name not in BASE]
    span = _span(temperature, truths)
    scale = _scale(joint, course_of, seconds, span)
    drawn = {row.name: _chosen(row, row.draw(rng, scale, joint), given) for row in truths}
    _refuse_leftovers(given, drawn)
    influences = [row.build(drawn[row.name], joint) for row in truths]
    plant = Plant(joint, influences)
    angles = _integrate(plant, course_of, seconds, rate_hz, span)
    return _recorded(angles, rng, (bits_in, bits_out), {
        "balance": "torsion",
        "effects": [row.name for row in truths],
        "seed": seed,
        "motion": course_of.name,
        "seconds": seconds,
        "rate_hz": rate_hz,
        "bits_in": bits_in,
        "bits_out": bits_out,
        "torque_rms_Nm": angles.torque_rms_Nm,
        "twist_rms_rad": angles.twist_rms_rad,
        "parameters": _flat(joint, drawn),
    })  # fmt: skip


HIDDEN_CASES: tuple[tuple[str, ...], ...] = (
    (),
    *((row.name,) for row in ROWS if row.name not in ("torque_ripple", "inertia_error", "lugre_friction")),
    ("kinematic_error", "coulomb_friction"),
    ("kinematic_error", "bouc_wen_hysteresis"),
    ("gravity_load", "coulomb_friction"),
    ("encoder_skew", "kinematic_error"),
    *((row.name,) for row in OUTSIDE),
)
"""What `hidden` draws from: left out are those that this balance cannot tell from another by their nature"""


def hidden(seed: int, seconds: float = 30.0, bits_out: int = 24) -> Simulated:
    """A recording with an effect that the columns do not name; `truth` does. The same seed, the same recording."""
    rng = np.random.default_rng([seed, 0x5EA1])
    case = HIDDEN_CASES[int(rng.integers(len(HIDDEN_CASES)))]
    return simulate(case, seconds, seed=int(rng.integers(2**31)), bits_out=bits_out)


def _joint(rng: np.random.Generator, given: dict[str, float]) -> Joint:
    """Sizes of gears 14 to 25 with a load; damping is chosen."""
    drawn = {
        "inertia_kg_m2": rng.uniform(0.05, 0.2),
        "stiffness_Nm_per_rad": rng.uniform(2e4, 4e4),
        "damping_Nms_per_rad": rng.uniform(4.0, 7.5),
        "ratio": RATIO,
    }
    return Joint(**{name: float(given.pop(name, value)) for name, value in drawn.items()})


def _truth(name: str, rng: np.random.Generator) -> Truth:
    if name == "outside":
        return OUTSIDE[int(rng.integers(len(OUTSIDE)))]
    if name == "hysteresis":
        return TRUTHS[str(rng.choice(["bouc_wen_hysteresis", "maxwell_slip_hysteresis"]))]
    if name not in TRUTHS:
        known = ", ".join((*BASE, *TRUTHS, "outside"))
        raise UnknownEffect(f"effect {name!r}: the simulated drive has: {known}")
    return TRUTHS[name]


def _chosen(row: Truth, drawn: dict[str, float], given: dict[str, float]) -> dict[str, float]:
    return {name: float(given.pop(f"{row.name}.{name}", value)) for name, value in drawn.items()}


def _refuse_leftovers(given: Mapping[str, float], drawn: Mapping[str, Mapping[str, float]]) -> None:
    if given:
        known = ["inertia_kg_m2", "stiffness_Nm_per_rad", "damping_Nms_per_rad", "ratio"]
        known += [f"{effect}.{name}" for effect, values in drawn.items() for name in values]
        raise BadInput(f"parameter {next(iter(given))!r}: expected one of {', '.join(known)}")


def _flat(joint: Joint, drawn: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    flat = {
        "inertia_kg_m2": joint.inertia_kg_m2,
        "stiffness_Nm_per_rad": joint.stiffness_Nm_per_rad,
        "damping_Nms_per_rad": joint.damping_Nms_per_rad,
        "ratio": joint.ratio,
    }
    return flat | {f"{effect}.{name}": value for effect, values in drawn.items() for name, value in values.items()}


def _span(temperature: Temperature | None, truths: Sequence[Truth]) -> tuple[float, float]:
    if temperature is None:
        rise = WARM_UP_K if any(row.warms for row in truths) else 0.0
        return (REFERENCE_DEGC, REFERENCE_DEGC + rise)
    return temperature if isinstance(temperature, tuple) else (temperature, temperature)


def temperature_at(time_s: Array, span: tuple[float, float]) -> Array:
    """(n,) [degC] of a warm-up from the first to (nearly) the second."""
    start, end = span
    return np.asarray(start + (end - start) * -np.expm1(-np.maximum(time_s, 0.0) / WARM_UP_S))


def _scale(joint: Joint, motion: MotorMotion, seconds: float, span: tuple[float, float]) -> Scale:
    """What a rigid joint would do: exact enough far below the resonance."""
    course = motion.course(np.arange(0.0, seconds, 2e-3))
    torque = joint.inertia_kg_m2 * course.acceleration / joint.ratio
    jerk = np.gradient(torque, 2e-3)
    stiffness = joint.stiffness_Nm_per_rad
    rise = max(abs(span[0] - REFERENCE_DEGC), abs(span[1] - REFERENCE_DEGC)) or WARM_UP_K
    return Scale(
        torque_Nm=_rms(torque),
        twist_rad=_rms(torque) / stiffness,
        twist_rate_rad_s=_rms(jerk) / stiffness,
        speed_out_rad_s=_rms(course.speed) / joint.ratio,
        temperature_rise_K=rise,
    )


@dataclass(frozen=True, slots=True)
class Angles:
    """What the encoders could see, before they do."""

    time_s: Array
    theta_in_rad: Array
    theta_out_rad: Array
    temperature_degC: Array
    torque_rms_Nm: float
    twist_rms_rad: float


def _integrate(plant: Plant, motion: MotorMotion, seconds: float, rate_hz: float, span: tuple[float, float]) -> Angles:
    every = round(1.0 / (SUBSTEP_S * rate_hz))
    if every < 1 or abs(every * SUBSTEP_S * rate_hz - 1.0) > 1e-9:
        raise BadInput(f"rate_hz {rate_hz}: expected {1 / SUBSTEP_S:.0f} divided by a whole number")
    lead = round(LEAD_IN_S / SUBSTEP_S)
    steps = round(seconds * rate_hz) * every
    end_s: Array = (np.arange(-lead, steps, dtype=np.float64) + 1) * SUBSTEP_S
    middle_s = end_s - 0.5 * SUBSTEP_S
    twist, _ = plant.run(middle_s, motion.course(middle_s), temperature_at(middle_s, span))
    kept = slice(lead - 1, None, every)
    motor = motion.course(end_s[kept])
    true_out = plant.input_angle(motion.course(end_s)).angle - twist
    acceleration = np.gradient(np.gradient(true_out[kept]), 1.0) * rate_hz**2
    return Angles(
        time_s=np.arange(steps // every + 1) / rate_hz,
        theta_in_rad=motor.angle,
        theta_out_rad=seen(true_out, plant.influences, kept),
        temperature_degC=temperature_at(end_s[kept], span),
        torque_rms_Nm=plant.joint.inertia_kg_m2 * _rms(acceleration[2:-2]),
        twist_rms_rad=_rms(twist[kept]),
    )


def seen(true_out_rad: Array, influences: Sequence[Influence], kept: slice) -> Array:
    """(m,) what the output encoder reads, at every substep that is `kept`: late by its skew, off its centre.

    Positive skew: the value belongs to a later instant than its stamp says.
    """
    angle = true_out_rad
    skew_s = sum(influence.skew_s for influence in influences)
    if skew_s:
        angle = _shifted(true_out_rad, skew_s / SUBSTEP_S)
    return off_centre(angle[kept], influences)


def _shifted(angle: Array, steps: float) -> Array:
    """(n,) `angle` read `steps` samples later, by cubic interpolation (error (omega*h)^4/100: none at 8 kHz)."""
    at = np.clip(np.arange(len(angle)) + steps, 1.0, len(angle) - 2.001)
    i = at.astype(int)
    x = at - i
    a, b, c, d = angle[i - 1], angle[i], angle[i + 1], angle[np.minimum(i + 2, len(angle) - 1)]
    return np.asarray(b + 0.5 * x * (c - a + x * (2 * a - 5 * b + 4 * c - d + x * (3 * (b - c) + d - a))))


def quantised(angle_rad: Array, bits: int, rng: np.random.Generator) -> Array:
    """(n,) what an encoder of `bits` per turn says, noise before rounding; unchanged for 0 bits."""
    if bits == 0:
        return angle_rad
    step = 2 * math.pi / 2**bits
    noise = rng.normal(0.0, ENCODER_NOISE_STEPS, len(angle_rad))
    return np.asarray(np.rint(angle_rad / step + noise) * step)


def _recorded(angles: Angles, rng: np.random.Generator, bits: tuple[int, int], truth: dict[str, object]) -> Simulated:
    columns = {
        "theta_in_rad": quantised(angles.theta_in_rad, bits[0], rng),
        "theta_out_rad": quantised(angles.theta_out_rad, bits[1], rng),
        "temperature_degC": np.round(angles.temperature_degC, 2),
    }
    return Simulated(angles.time_s, columns, truth)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

"""The torsion truth: a motor that follows its motion, a compliant gear and its load, an encoder on each side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.rig.motion import MOTIONS, Array, MotorMotion
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant, off_centre
from edge_daemon.rig.simulated import (
    RATIO,
    WARM_UP_K,
    Simulated,
    Temperature,
    UnknownEffect,
    quantised,
    temperature_at,
)
from edge_daemon.rig.truths import OUTSIDE, REFERENCE_DEGC, TRUTHS, Scale, Truth

LEAD_IN_S = 0.5
"""integrated before the recording starts, so that the start-up swing is gone"""
BASE = ("linear_stiffness", "viscous_damping")
"""always part of the simulated joint; may be named, adds nothing"""


def simulate_joint(
    effects: Sequence[str],
    seconds: float,
    seed: int,
    rate_hz: float,
    bits: tuple[int, int],
    motion: str | MotorMotion,
    temperature: Temperature | None,
    parameters: Mapping[str, float],
) -> Simulated:
    """A recording of both encoders, `bits` = (input, output), and the temperature."""
    given = dict(parameters)
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
    return _recorded(angles, rng, bits, {
        "balance": "torsion",
        "effects": [row.name for row in truths],
        "seed": seed,
        "motion": course_of.name,
        "seconds": seconds,
        "rate_hz": rate_hz,
        "bits_in": bits[0],
        "bits_out": bits[1],
        "torque_rms_Nm": angles.torque_rms_Nm,
        "twist_rms_rad": angles.twist_rms_rad,
        "parameters": _flat(joint, drawn),
    })  # fmt: skip


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
        raise UnknownEffect(name, (*BASE, *TRUTHS, "outside"))
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


def _recorded(angles: Angles, rng: np.random.Generator, bits: tuple[int, int], truth: dict[str, object]) -> Simulated:
    columns = {
        "theta_in_rad": quantised(angles.theta_in_rad, bits[0], rng),
        "theta_out_rad": quantised(angles.theta_out_rad, bits[1], rng),
        "temperature_degC": np.round(angles.temperature_degC, 2),
    }
    return Simulated(angles.time_s, columns, truth)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))

"""The torsion truth: a motor that follows its motion, a compliant gear and its load, an encoder on each side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.records import Array
from edge_daemon.rig.motion import MOTIONS, MotorCourse, MotorMotion
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant, off_centre
from edge_daemon.rig.simulated import (
    RATIO,
    REFERENCE_DEGC,
    WARM_UP_K,
    Given,
    Simulated,
    UnknownEffect,
    Wanted,
    quantised,
    temperature_at,
)
from edge_daemon.rig.truths import DRAWN_OUTSIDE, TRUTHS, Truth, rms, scale_of

LEAD_IN_S = 0.5
"""So much is integrated before the recording starts, so that the start-up swing is gone."""
TOOTH_PASSES = 4
"""Runs after which the teeth pass where the output is: each brings it fifty times nearer."""
BASE = ("linear_stiffness", "viscous_damping")
"""These are always part of the simulated joint; they may be named, and add nothing."""


def simulate_joint(wanted: Wanted, laws: Sequence[Truth] = ()) -> Simulated:
    """A recording of both encoders and the temperature; `laws` beside the effects that are wanted by name."""
    given, rng = Given(wanted.parameters), np.random.default_rng(wanted.seed)
    joint = _joint(rng, given)
    motion = MOTIONS[wanted.motion](wanted.seconds, rng) if isinstance(wanted.motion, str) else wanted.motion
    truths = [*(_truth(name, rng) for name in wanted.effects if name not in BASE), *laws]
    span = wanted.span(any(row.warms for row in truths))
    rise_K = max(abs(span[0] - REFERENCE_DEGC), abs(span[1] - REFERENCE_DEGC)) or WARM_UP_K
    scale = scale_of(joint, motion, wanted.seconds, rise_K)
    drawn = {row.name: given.of(row.name, row.draw(rng, scale, joint)) for row in truths}
    given.refuse_leftovers()

    def plant(behind: MotorCourse | None = None) -> Plant:
        return Plant(joint, [row.build(drawn[row.name], joint) for row in truths], behind=behind)

    angles = _integrate(plant, motion, wanted, span)
    columns = {
        "theta_in_rad": quantised(angles.theta_in_rad, wanted.bits_in, rng),
        "theta_out_rad": quantised(angles.theta_out_rad, wanted.bits_out, rng),
        "temperature_degC": np.round(angles.temperature_degC, 2),
    }
    truth = wanted.truth("torsion", drawn, motion) | {
        "bits_in": wanted.bits_in,
        "torque_rms_Nm": angles.torque_rms_Nm,
        "twist_rms_rad": angles.twist_rms_rad,
        "parameters": given.chosen,
    }
    return Simulated(angles.time_s, columns, truth)


def _joint(rng: np.random.Generator, given: Given) -> Joint:
    """Sizes of gears 14 to 25 with a load; damping is chosen."""
    drawn = {
        "inertia_kg_m2": rng.uniform(0.05, 0.2),
        "stiffness_Nm_per_rad": rng.uniform(2e4, 4e4),
        "damping_Nms_per_rad": rng.uniform(4.0, 7.5),
        "ratio": RATIO,
    }
    return Joint(**{name: given.value(name, value) for name, value in drawn.items()})


def _truth(name: str, rng: np.random.Generator) -> Truth:
    if name == "outside":
        return TRUTHS[DRAWN_OUTSIDE[int(rng.integers(len(DRAWN_OUTSIDE)))]]
    if name == "hysteresis":
        return TRUTHS[str(rng.choice(["bouc_wen_hysteresis", "maxwell_slip_hysteresis"]))]
    if name not in TRUTHS:
        raise UnknownEffect(name, (*BASE, *TRUTHS, "outside"))
    return TRUTHS[name]


@dataclass(frozen=True, slots=True)
class TrueAngles:
    """What the encoders could see, before they do."""

    time_s: Array
    theta_in_rad: Array
    theta_out_rad: Array
    temperature_degC: Array
    torque_rms_Nm: float
    twist_rms_rad: float


def _integrate(
    fresh: Callable[..., Plant], motion: MotorMotion, wanted: Wanted, span: tuple[float, float]
) -> TrueAngles:
    rate_hz = wanted.rate_hz
    every = round(1.0 / (SUBSTEP_S * rate_hz))
    if every < 1 or abs(every * SUBSTEP_S * rate_hz - 1.0) > 1e-9:
        raise BadInput(f"rate_hz {rate_hz}: expected {1 / SUBSTEP_S:.0f} divided by a whole number")
    lead = round(LEAD_IN_S / SUBSTEP_S)
    steps = round(wanted.seconds * rate_hz) * every
    end_s: Array = (np.arange(-lead, steps, dtype=np.float64) + 1) * SUBSTEP_S
    middle_s = end_s - 0.5 * SUBSTEP_S
    middle, end = motion.course(middle_s), motion.course(end_s)
    plant, behind = fresh(), None
    for _ in range(TOOTH_PASSES if any(influence.tooth for influence in plant.influences) else 1):
        plant = fresh(behind)
        twist, _ = plant.run(middle_s, middle, temperature_at(middle_s, span))
        true_out = plant.input_angle(end).angle - twist
        late = end.angle / plant.joint.ratio - true_out
        behind = MotorCourse(late, rate := np.gradient(late, SUBSTEP_S), np.gradient(rate, SUBSTEP_S))
    kept = slice(lead - 1, None, every)
    motor = motion.course(end_s[kept])
    acceleration = np.gradient(np.gradient(true_out[kept]), 1.0) * rate_hz**2
    return TrueAngles(
        time_s=np.arange(steps // every + 1) / rate_hz,
        theta_in_rad=motor.angle,
        theta_out_rad=seen(true_out, plant.influences, kept),
        temperature_degC=temperature_at(end_s[kept], span),
        torque_rms_Nm=plant.joint.inertia_kg_m2 * rms(acceleration[2:-2]),
        twist_rms_rad=rms(twist[kept]),
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

"""The torsion truth: a motor that follows its motion, a compliant gear and its load, an encoder on each side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.gear.torques import GearLaw
from edge_daemon.records import Array
from edge_daemon.rig.motion import MOTIONS, MotorCourse, MotorMotion
from edge_daemon.rig.plant import SUBSTEP_S, Joint, Plant, off_centre, stages
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
        influences = [row.build(drawn[row.name], joint) for row in truths]
        fineness = max((i.twist.fineness for i in influences if isinstance(i.twist, GearLaw)), default=1)
        return Plant(joint, influences, step_s=SUBSTEP_S / fineness, behind=behind)

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


STRETCH = 100_000
"""Steps that are simulated at a time: half a minute of the finest took 900 MiB at once."""


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
    plant, rate_hz = fresh(), wanted.rate_hz
    step_s = plant.step_s
    every = round(1.0 / (step_s * rate_hz))
    if rate_hz * SUBSTEP_S > 1.001 or abs(every * step_s * rate_hz - 1.0) > 1e-9:
        raise BadInput(f"rate_hz {rate_hz}: expected {1 / SUBSTEP_S:.0f} divided by a whole number")
    lead, steps = round(LEAD_IN_S / step_s), round(wanted.seconds * rate_hz) * every
    end_s: Array = (np.arange(-lead, steps, dtype=np.float64) + 1) * step_s
    twist = _run(plant, motion, range(-lead, steps), span)
    late = None
    for _ in range(TOOTH_PASSES - 1 if any(influence.tooth for influence in plant.influences) else 0):
        late = _behind(plant, motion, end_s, twist, late)
        plant = fresh()
        twist = _run(plant, motion, range(-lead, steps), span, late)
    at_s, bent = end_s[lead - 1 :: every], twist[lead - 1 :: every]

    def out(time_s: Array, twist: Array) -> Array:
        plant.behind = late(time_s) if late else None
        return np.asarray(plant.input_angle(motion.course(time_s)).angle - twist)

    skew_s = sum(influence.skew_s for influence in plant.influences)
    exact = seen = out(at_s, bent)
    if skew_s:
        read_s = np.clip(at_s + skew_s, end_s[0], end_s[-1])
        seen = out(read_s, _line(end_s, twist)(read_s))
    acceleration = np.gradient(np.gradient(exact)) * rate_hz**2
    return TrueAngles(
        time_s=np.arange(steps // every + 1) / rate_hz,
        theta_in_rad=motion.course(at_s).angle,
        theta_out_rad=off_centre(seen, plant.influences),
        temperature_degC=temperature_at(at_s, span),
        torque_rms_Nm=plant.joint.inertia_kg_m2 * rms(acceleration[2:-2]),
        twist_rms_rad=rms(bent),
    )


Late = Callable[[Array], MotorCourse]
"""(n,) instants -> how far the output stays behind a rigid gear, with its derivatives"""


def _run(plant: Plant, motion: MotorMotion, steps: range, span: tuple[float, float], late: Late | None = None) -> Array:
    """Twist (n,) at the end of each step, a stretch at a time."""
    parts = []
    for first in range(steps.start, steps.stop, STRETCH):
        inside_s = stages(first, min(STRETCH, steps.stop - first), plant.step_s)
        plant.behind = late(inside_s) if late else None
        parts.append(plant.run(inside_s, motion.course(inside_s), temperature_at(inside_s, span), compiled=True)[0])
    return np.concatenate(parts)


def _behind(plant: Plant, motion: MotorMotion, end_s: Array, twist: Array, late: Late | None) -> Late:
    """What `Plant.behind` is to be, after a run that had `late` there."""
    motor = motion.course(end_s)
    plant.behind = late(end_s) if late else None
    line = _line(end_s, motor.angle / plant.joint.ratio - plant.input_angle(motor).angle + twist)
    return lambda time_s: MotorCourse(*(np.asarray(line(time_s, order)) for order in range(3)))


def _line(time_s: Array, values: Array) -> Callable[..., Array]:
    """What goes smoothly through the values: (n,) instants, order of the derivative -> (n,)."""
    from scipy.interpolate import CubicSpline  # half a second that few recordings need

    return CubicSpline(time_s, values)

"""Where the output torque of a gear with two encoders comes from, and what each source costs in certainty.

On an arm it is neither inertia times acceleration nor, as a rule, measured: then it is that of the motor, times the
ratio, less what motor, bearings and wave generator take of it. That is fitted beside the model.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

from edge_daemon.effects.algebra import smooth_sign, stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.model import Model
from edge_daemon.records import Array, Motion

SENSOR, MOTOR, INERTIA = "torque_out_Nm", "torque_in_Nm", "output_inertia_kg_m2"
COSTS: Mapping[str, str] = {
    SENSOR: "measured: stiffness is as sure as the sensor's calibration",
    INERTIA: "inertia times acceleration: a wrong inertia is as wrong a stiffness, and nothing is told at rest",
    MOTOR: "ratio times the motor's torque: friction and inertia of the motor side are fitted beside the stiffness and "
    "make it less certain; nothing is estimated of it while the daemon runs",
}
"""Source of the torque -> what it is and what it costs."""
LOAD_SIDE = ("gravity_load", "inertia_error", "output_viscous_friction", "output_coulomb_friction")
"""Effects that are no part of a balance whose torque is the motor's: what the load takes passes the gear, and so is in
that torque already."""
WEIGHED = "gravity_load"
"""The effect that a torque sensor behind the gear carries: what looks like it there is rather what is taken for it."""
SIGN_RAD_S = 2e-3
"""Output speed at which the sign of the motor's friction has reached tanh(1): an arm creeps at ten times that."""


def torque_source(channels: Iterable[str], inertia_kg_m2: float) -> str:
    """The source that is used of the output torque; empty where there is none."""
    known = {*channels, *((INERTIA,) if math.isfinite(inertia_kg_m2) else ())}
    return next((name for name in (SENSOR, INERTIA, MOTOR) if name in known), "")


def of_output_angle(effect: Effect) -> bool:
    """Whether it is a curve of the output's angle, as the twist is where a weight makes it."""
    return effect.misreads == "theta_out_rad" or effect.name == WEIGHED


def with_motor_torque(columns: Mapping[str, Array], ratio: float) -> dict[str, Array]:
    """The columns with the motor's torque, seen at the output, as that of the output."""
    return {**columns, SENSOR: ratio * columns[MOTOR]}


def _motor_side(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    speed, acceleration = motion.driven_rad_s, motion.driven_rad_s2
    if speed is None or acceleration is None:
        speed, acceleration = motion.velocity_out_rad_s, motion.acceleration_out_rad_s2
    return stack(smooth_sign(speed, SIGN_RAD_S), speed, acceleration), state


MOTOR_SIDE = Effect(
    name="motor_side",
    balance="torsion",
    kind="torque",
    meaning="what motor, bearings and wave generator take of the motor's torque, seen at the output",
    equation="F_m sgn(omega_in) + c_m omega_in + J_m alpha_in, of the motor's angle over the ratio",
    source="Newton: torque balance of the motor side; Tuttle (1992), MIT AI-TR 1365",
    amplitudes=(
        Parameter("friction", "N m", "dry friction", 0.0, 1e5),
        Parameter("coefficient", "N m s/rad", "viscous friction", 0.0, 1e6),
        Parameter("inertia", "kg m^2", "inertia of the rotor, times the ratio squared", 0.0, 1e6),
    ),
    shapes=(),
    columns=_motor_side,
    needs=(SENSOR,),
)
"""No effect of the gear: it is in every model whose torque is the motor's, and where a torque that was recorded as the
output's turns out to be the motor's, a candidate."""
OUTPUT_FRICTION = "output_coulomb_friction"
LEAPING = (MOTOR_SIDE.name, OUTPUT_FRICTION)
"""Effects with a friction that leaps where the output turns round, which no sample tells."""
DIRECTED = re.compile(r"\b(sign|tanh)\(\(*[^()]*velocity_out_rad_s")
"""What a formula calls the direction of the output."""


def leaping(model: Model) -> tuple[str, ...]:
    """The effects of a model with two encoders that leap so, formulas of the output's direction among them."""
    formulas = {row.name for row in model.effects if DIRECTED.search((row.expression or "").replace(" ", ""))}
    return tuple(row.name for row in model.effects if row.name in LEAPING or row.name in formulas)


ROWS = (MOTOR_SIDE,)

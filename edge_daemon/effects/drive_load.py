"""Friction of a drive that grows with the torque that passes its gear to the load, as the rest of a model tells it.

What moves the motor's own inertia never passes the gear: beside a weight or a model torque, friction of the load tells
how much of the inertia that is. In the equations sgn(omega_out) is how far that friction has built up where the model
has presliding (`presliding`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from edge_daemon.effects.algebra import rubbing, stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.friction import OUTPUT_STRIBECK_SPEED, STRIBECK_EXPONENT
from edge_daemon.records import Array, Motion

SELF_LOCKING = 1.0
"""Friction per load at which no load drives the motor any more: measured drives lose a tenth, and friction of the
motor's own torque that comes near it explains any torque by itself."""
MOTOR_SHARE = Parameter(
    "motor_share",
    "1",
    "share of the inertia that is the motor's: what moves it never passes the gear",
    0.0,
    1.0,
    0.0,
    "",
    (0.0, 0.5),
    asks="external_Nm",
)
"""Rotor and wave generator are a tenth to two thirds of a joint's inertia; what the load is without it is told by a
weight or a model torque alone."""
_SQUARES = (
    Parameter("driving", "1/(N m)", "friction per square of the transmitted torque, motor drives", 0.0, 1e3),
    Parameter("backdriven", "1/(N m)", "the same where the load drives", 0.0, 1e3),
)


def load_of(motion: Motion, shape: Mapping[str, float]) -> Array:
    """(n,) torque that passes the gear to the load, as the rest of the model tells it; 0 where nothing does."""
    return np.zeros(len(motion)) if motion.transmitted_Nm is None else motion.transmitted_Nm - _rotors(motion, shape)


def _rotors(motion: Motion, shape: Mapping[str, float]) -> Array:
    """(n,) torque that moves the motor's own inertia, and never comes to the gear."""
    return np.asarray(shape["motor_share"] * motion.inertia_kg_m2 * motion.acceleration_out_rad_s2)


def _load_dependent(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.abs(load_of(motion, shape)) * rubbing(motion)), state


def _squared_load(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    load, sign = load_of(motion, shape), rubbing(motion)
    return stack(load**2 * sign * (load * sign > 0), load**2 * sign * (load * sign <= 0)), state


def _both_sides(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    if motion.motor_Nm is None or motion.external_Nm is None:
        return np.zeros((len(motion), 1)), state
    motor = motion.motor_Nm - _rotors(motion, shape)
    return stack(np.abs(motor - shape["external_share"] * motion.external_Nm) * rubbing(motion)), state


def _creep_load(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    creep = np.exp(-(np.abs(motion.velocity_out_rad_s / shape["creep_speed"]) ** shape["exponent"]))
    columns = np.hstack((_load_dependent(motion, shape, None)[0], _squared_load(motion, shape, None)[0]))
    return creep[:, None] * columns, state


ROWS = (
    Effect(
        name="load_dependent_friction",
        balance="drive",
        kind="torque",
        meaning="friction that grows with the torque that passes the gear: inertia, gravity, coupling",
        equation="m |tau_load| sgn(omega_out), tau_load = (1 - s) J alpha_out + gravity + model torque",
        source="Taghirad & Belanger (1998), ASME J. Dyn. Sys. Meas. Control 120(4)",
        amplitudes=(Parameter("coefficient", "1", "friction torque per transmitted torque", 0.0, SELF_LOCKING),),
        shapes=(MOTOR_SHARE,),
        columns=_load_dependent,
        rubs=True,
        refines=("coulomb_friction",),
        loaded=True,
    ),
    Effect(
        name="squared_load_friction",
        balance="drive",
        kind="torque",
        meaning="friction with the square of the torque that passes the gear, unlike for who drives: motor or load",
        equation="q tau_load^2 sgn(omega_out), q = q_d where tau_load omega_out > 0, q_b elsewhere",
        source="Duclusaud & Passault (2024), extended friction model M6 of servo actuators, at any speed",
        amplitudes=_SQUARES,
        shapes=(MOTOR_SHARE,),
        columns=_squared_load,
        rubs=True,
        refines=("coulomb_friction", "load_dependent_friction"),
        yields_to=("load_dependent_friction",),
        loaded=True,
    ),
    Effect(
        name="two_sided_load_friction",
        balance="drive",
        kind="torque",
        meaning="friction of the torques on both sides of the gear: of the motor and of what stands against it outside",
        equation="b |tau_motor - s J alpha_out - e tau_external| sgn(omega_out), tau_external = J alpha_out - tau_load "
        "at s = 0",
        source="Duclusaud & Passault (2024), extended friction models M3 (e = 1) to M6 (e = 0) of servo actuators: "
        "the inertia is the motor's, whose torque holds all friction",
        amplitudes=(
            Parameter("coefficient", "1", "friction torque per torque of the two sides", 0.0, SELF_LOCKING / 2),
        ),
        shapes=(
            Parameter("external_share", "1", "weight of the torque outside", 0.0, 1.5, 1.0, "", (0.0, 1.0)),
            MOTOR_SHARE,
        ),
        columns=_both_sides,
        rubs=True,
        refines=("coulomb_friction",),
        yields_to=("load_dependent_friction",),
        loaded=True,
    ),
    Effect(
        name="creep_load_friction",
        balance="drive",
        kind="torque",
        meaning="load friction at creep, with the square of the load, unlike for who drives: the motor or the load",
        equation="(m |tau_load| + q tau_load^2) exp(-|omega_out / v_c|^n) sgn(omega_out), n = 2 or 1, "
        "q = q_d where tau_load omega_out > 0, q_b elsewhere",
        source="Duclusaud & Passault (2024), extended friction models M4 to M6 of servo actuators; "
        "a linear term that differs by who drives is a torque gain and cannot be told from one",
        amplitudes=(
            Parameter("coefficient", "1", "friction per transmitted torque at creep", 0.0, SELF_LOCKING),
            *_SQUARES,
        ),
        shapes=(
            replace(OUTPUT_STRIBECK_SPEED, name="creep_speed", meaning="output speed at which it has fallen to 1/e"),
            STRIBECK_EXPONENT,
            MOTOR_SHARE,
        ),
        columns=_creep_load,
        rubs=True,
        refines=("load_dependent_friction",),
        loaded=True,
        yields_to=("squared_load_friction", "two_sided_load_friction"),
    ),
)

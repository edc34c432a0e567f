"""The drive balance: motor torque or current against the motion of one encoder.

Amplitudes carry the unit of the balance: N m of motor torque, or A where only the current is known (written `N m`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.effects.algebra import smooth_sign, stack, stop_operator
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Wave
from edge_daemon.effects.friction import STRIBECK_LEVELS, STRIBECK_SPEED, stribeck_columns
from edge_daemon.effects.stiffness import REFERENCE_DEGC
from edge_daemon.effects.waves import in_words, of_input, wave_parameters, waves
from edge_daemon.records import Array, Motion

SIGN_RAD_S, SIGN_SHARE = 2e-3, 0.01
"""Output speed at which a sign has reached tanh(1), at the most and over the rms speed: it is no number of the gear,
since where the sign is not seen nothing is fitted, and one that is free bends any friction into any other. On a slow
joint the former alone rounds off a tenth of the motion, and presliding was named for it."""

OUTPUT_STRIBECK_SPEED = replace(
    STRIBECK_SPEED,
    meaning="output speed at which the excess has fallen to 1/e",
    lower=1e-3,
    upper=3.0,
    start=0.1,
    scale="velocity_out_rad_s",
    grid=(0.05, 0.15, 0.4, 1.0),
)

ELEMENT_WIDTHS = (1.0, 3.0, 9.0, 27.0)
"""Widths of the presliding elements over that of the narrowest: a threefold step leaves 3 % of a smooth curve."""


def _rounded(motion: Motion) -> float:
    """The speed at which the sign of a motion has reached tanh(1)."""
    usual = math.sqrt(float(np.nanmean(motion.velocity_out_rad_s**2)))
    return min(SIGN_RAD_S, SIGN_SHARE * usual) or SIGN_RAD_S


def _sign(motion: Motion) -> Array:
    return smooth_sign(motion.velocity_out_rad_s, _rounded(motion))


def _inertia(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.acceleration_out_rad_s2), state


def _viscous(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.velocity_out_rad_s), state


def _coulomb(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(_sign(motion)), state


def _asymmetric(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    sign = _sign(motion)
    return stack((1 + sign) / 2, (sign - 1) / 2), state


def _stribeck(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stribeck_columns(motion.velocity_out_rad_s, {**shape, "smoothing": _rounded(motion)}), state


def _power_of_speed(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(_sign(motion) * np.abs(motion.velocity_out_rad_s) ** shape["exponent"]), state


def _transmitted(motion: Motion) -> Array:
    """(n,) torque that passes the gear to the load, as the rest of the model tells it; 0 where nothing does."""
    return np.zeros(len(motion)) if motion.transmitted_Nm is None else motion.transmitted_Nm


def _load_dependent(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.abs(_transmitted(motion)) * _sign(motion)), state


def _squared_load(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    load, sign = _transmitted(motion), _sign(motion)
    return stack(load**2 * sign * (load * sign > 0), load**2 * sign * (load * sign <= 0)), state


def _both_sides(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    if motion.motor_Nm is None or motion.external_Nm is None:
        return np.zeros((len(motion), 1)), state
    return stack(np.abs(motion.motor_Nm - shape["external_share"] * motion.external_Nm) * _sign(motion)), state


def _creep_load(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    creep = np.exp(-((motion.velocity_out_rad_s / shape["creep_speed"]) ** 2))
    columns = np.hstack((_load_dependent(motion, shape, None)[0], _squared_load(motion, shape, None)[0]))
    return creep[:, None] * columns, state


def _model_torque(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.extra["torque_model_Nm"]), state


def _constant(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.ones(len(motion))), state


def _gravity(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.sin(motion.theta_out_rad), np.cos(motion.theta_out_rad)), state


def _ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    columns = waves(motion, rows)
    return np.hstack((columns, _sign(motion)[:, None] * columns)), state


def _load_ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    return np.abs(_transmitted(motion))[:, None] * waves(motion, rows), state


def _thermal(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack((motion.temperature_degC - REFERENCE_DEGC) * motion.velocity_out_rad_s), state


def _maxwell_slip(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    slips = state if state is not None else (None,) * len(ELEMENT_WIDTHS)
    rows = [
        stop_operator(motion.theta_out_rad, shape["width"] * times, slip)
        for times, slip in zip(ELEMENT_WIDTHS, slips, strict=True)
    ]
    return stack(*(z for z, _ in rows)), tuple(slip for _, slip in rows)


def _hysteresis(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    z, state = stop_operator(motion.theta_out_rad, shape["width"], state)
    return stack(z), state


SELF_LOCKING = 1.0
"""Friction per load at which no load drives the motor any more: measured drives lose a tenth, and friction of the
motor's own torque that comes near it explains any torque by itself."""
_LEVEL = Parameter("friction", "N m", "friction torque", 0.0, 1e5)
_SQUARES = (
    Parameter("driving", "1/(N m)", "friction per square of the transmitted torque, motor drives", 0.0, 1e3),
    Parameter("backdriven", "1/(N m)", "the same where the load drives", 0.0, 1e3),
)


def wave_generator_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple of the motor's torque over some waves."""
    return Effect(
        name="wave_generator_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator or the teeth, different in each direction",
        equation=("sum_m (s_m + t_m sgn omega) sin(m theta) + (c_m + d_m sgn omega) cos(m theta), " + in_words(rows)),
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=wave_parameters("N m", rows, "input")
        + wave_parameters("N m", rows, "input", "_directed", " that changes sign with the motion"),
        shapes=(),
        columns=partial(_ripple, rows),
        waves=rows,
        carriers=("", "direction"),
        over=wave_generator_ripple,
    )


def load_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple that the load makes, over some waves."""
    return Effect(
        name="load_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator or the teeth, and grows with the load",
        equation="sum_m (s_m sin(m theta) + c_m cos(m theta)) |tau_load|, " + in_words(rows),
        source="Taghirad & Belanger (1998), J. Dyn. Sys. Meas. Control 120(4): friction of the load, over an angle",
        amplitudes=wave_parameters("1", rows, "input"),
        shapes=(),
        columns=partial(_load_ripple, rows),
        waves=rows,
        carriers=("load",),
        over=load_ripple,
        yields_to=("wave_generator_ripple",),
        loaded=True,
    )


ROWS = (
    Effect(
        name="inertia",
        balance="drive",
        kind="torque",
        meaning="inertia of rotor, wave generator and load, seen by the motor",
        equation="J alpha_out",
        source="Newton",
        amplitudes=(Parameter("inertia", "N m s^2/rad", "torque per output acceleration", 0.0, 1e6),),
        shapes=(),
        columns=_inertia,
        follows="acceleration_out_rad_s2",
        carried=True,
    ),
    Effect(
        name="model_torque",
        balance="drive",
        kind="torque",
        meaning="what the robot's controller reckons for this joint: inertia, gravity and coupling of all joints",
        equation="g tau_model",
        source="inverse dynamics of the robot, as its controller logs it (Featherstone 2008, chapter 5)",
        amplitudes=(Parameter("gain", "N m/Nm", "motor torque per model torque at the output"),),
        shapes=(),
        columns=_model_torque,
        needs=("torque_model_Nm",),
        carried=True,
    ),
    Effect(
        name="constant_torque",
        balance="drive",
        kind="torque",
        meaning="a torque that never changes: zero of the current sensor, a weight on a belt, a spring",
        equation="tau_0",
        source="Newton: torque balance at rest",
        amplitudes=(Parameter("torque", "N m", "motor torque at rest"),),
        shapes=(),
        columns=_constant,
        yields_to=("coulomb_friction",),
        steady="exactly",
    ),
    Effect(
        name="viscous_friction",
        balance="drive",
        kind="torque",
        meaning="friction proportional to speed: grease and seals",
        equation="c omega_out",
        source="Tuttle (1992), MIT AI-TR 1365",
        amplitudes=(Parameter("coefficient", "N m s/rad", "torque per output speed", 0.0, 1e6),),
        shapes=(),
        columns=_viscous,
        follows="velocity_out_rad_s",
    ),
    Effect(
        name="coulomb_friction",
        balance="drive",
        kind="torque",
        meaning="friction that only knows the direction",
        equation="F_c sgn(omega_out)",
        source="Coulomb's law, smoothed sign: Andersson, Soderberg & Bjorklund (2007), Tribol. Int. 40(4)",
        amplitudes=(_LEVEL,),
        shapes=(),
        columns=_coulomb,
    ),
    Effect(
        name="asymmetric_friction",
        balance="drive",
        kind="torque",
        meaning="friction of a different level in each direction",
        equation="F_p (1 + s)/2 - F_n (1 - s)/2, s = sgn(omega_out)",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7)",
        amplitudes=(
            Parameter("forward", "N m", "friction torque in positive motion", 0.0, 1e5),
            Parameter("backward", "N m", "friction torque in negative motion", 0.0, 1e5),
        ),
        shapes=(),
        columns=_asymmetric,
        refines=("coulomb_friction",),
        steady="exactly",
        yields_to=("constant_torque",),
    ),
    Effect(
        name="stribeck_friction",
        balance="drive",
        kind="torque",
        meaning="friction that is larger at creep than in motion",
        equation="(F_c + F_e exp(-(omega_out / v_st)^2)) sgn(omega_out)",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7) (Gaussian form)",
        amplitudes=STRIBECK_LEVELS,
        shapes=(OUTPUT_STRIBECK_SPEED,),
        columns=_stribeck,
        refines=("coulomb_friction",),
    ),
    Effect(
        name="sublinear_friction",
        balance="drive",
        kind="torque",
        meaning="churning friction that grows more slowly than speed",
        equation="F_s |omega_out|^n sgn(omega_out), n < 1",
        source="Palmgren (1959), Ball and Roller Bearing Engineering: n = 2/3 for churning losses",
        amplitudes=(Parameter("coefficient", "N m (s/rad)^n", "friction torque at 1 rad/s", 0.0, 1e5),),
        shapes=(Parameter("exponent", "1", "power of the speed", 0.1, 0.95, 0.5, "", (0.3, 0.5, 0.67)),),
        columns=_power_of_speed,
        refines=("viscous_friction", "coulomb_friction"),
    ),
    Effect(
        name="superlinear_friction",
        balance="drive",
        kind="torque",
        meaning="drag that grows faster than speed, as cubic laws of friction have it",
        equation="F_s |omega_out|^n sgn(omega_out), n > 1",
        source="Tuttle (1992), MIT AI-TR 1365; Wolf & Iskandar (2018), ICRA (nonlinear viscous friction)",
        amplitudes=(Parameter("coefficient", "N m (s/rad)^n", "friction torque at 1 rad/s", 0.0, 1e5),),
        shapes=(Parameter("exponent", "1", "power of the speed", 1.2, 4.0, 2.0, "", (1.5, 2.0, 3.0)),),
        columns=_power_of_speed,
        refines=("viscous_friction", "coulomb_friction"),
    ),
    Effect(
        name="load_dependent_friction",
        balance="drive",
        kind="torque",
        meaning="friction that grows with the torque that passes the gear: inertia, gravity, coupling",
        equation="m |tau_load| sgn(omega_out), tau_load = J alpha_out + gravity + model torque",
        source="Taghirad & Belanger (1998), ASME J. Dyn. Sys. Meas. Control 120(4)",
        amplitudes=(Parameter("coefficient", "1", "friction torque per transmitted torque", 0.0, SELF_LOCKING),),
        shapes=(),
        columns=_load_dependent,
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
        shapes=(),
        columns=_squared_load,
        refines=("coulomb_friction", "load_dependent_friction"),
        yields_to=("load_dependent_friction",),
        loaded=True,
    ),
    Effect(
        name="two_sided_load_friction",
        balance="drive",
        kind="torque",
        meaning="friction of the torques on both sides of the gear: of the motor and of what stands against it outside",
        equation="b |tau_motor - e tau_external| sgn(omega_out), tau_external = J alpha_out - tau_load",
        source="Duclusaud & Passault (2024), extended friction models M3 (e = 1) to M6 (e = 0) of servo actuators: "
        "the inertia is the motor's, whose torque holds all friction",
        amplitudes=(
            Parameter("coefficient", "1", "friction torque per torque of the two sides", 0.0, SELF_LOCKING / 2),
        ),
        shapes=(Parameter("external_share", "1", "weight of the torque outside", 0.0, 1.5, 1.0, "", (0.0, 1.0)),),
        columns=_both_sides,
        refines=("coulomb_friction",),
        yields_to=("load_dependent_friction",),
        loaded=True,
    ),
    Effect(
        name="creep_load_friction",
        balance="drive",
        kind="torque",
        meaning="load friction at creep, with the square of the load, unlike for who drives: the motor or the load",
        equation="(m |tau_load| + q tau_load^2) exp(-(omega_out / v_c)^2) sgn(omega_out), "
        "q = q_d where tau_load omega_out > 0, q_b elsewhere",
        source="Duclusaud & Passault (2024), extended friction models M4 to M6 of servo actuators; "
        "a linear term that differs by who drives is a torque gain and cannot be told from one",
        amplitudes=(
            Parameter("coefficient", "1", "friction per transmitted torque at creep", 0.0, SELF_LOCKING),
            *_SQUARES,
        ),
        shapes=(
            replace(OUTPUT_STRIBECK_SPEED, name="creep_speed", meaning="output speed at which it has fallen to 1/e"),
        ),
        columns=_creep_load,
        refines=("load_dependent_friction",),
        loaded=True,
        yields_to=("squared_load_friction", "two_sided_load_friction"),
    ),
    Effect(
        name="gravity_load",
        balance="drive",
        kind="torque",
        meaning="weight or unbalance on the output",
        equation="g_s sin theta_out + g_c cos theta_out",
        source="Newton: torque of a weight on a lever in a plane",
        amplitudes=(
            Parameter("sine", "N m", "weight torque at an output angle of 90 degrees"),
            Parameter("cosine", "N m", "weight torque at an output angle of zero"),
        ),
        shapes=(),
        columns=_gravity,
        carried=True,
        yields_to=("constant_torque", "model_torque"),
    ),
    wave_generator_ripple(of_input(*MOTOR_ORDERS)),
    load_ripple(of_input(*MOTOR_ORDERS)),
    Effect(
        name="temperature_friction",
        balance="drive",
        kind="torque",
        meaning="viscous friction that changes with the temperature of the housing",
        equation="b_T (T - 25 degC) omega_out",
        source="linear term of a Taylor series about 25 degC",
        amplitudes=(Parameter("slope", "N m s/(rad K)", "change of viscous friction per kelvin"),),
        shapes=(),
        columns=_thermal,
        needs=("temperature_degC",),
        refines=("viscous_friction",),
    ),
    Effect(
        name="hysteresis",
        balance="drive",
        kind="torque",
        meaning="presliding hysteresis: friction builds up over a small angle after a reversal",
        equation="F z, dz = dtheta_out / w while |z| < 1",
        source="Iwan (1966), J. Appl. Mech. 33(4): one elasto-plastic element",
        amplitudes=(_LEVEL,),
        shapes=(
            Parameter(
                "width",
                "rad",
                "output angle over which the friction builds up",
                1e-5,
                0.5,
                1e-3,
                "",
                (1e-4, 1e-3, 1e-2, 0.1),
            ),
        ),
        columns=_hysteresis,
        slips=(1.0,),
        refines=("coulomb_friction",),
    ),
    Effect(
        name="maxwell_slip_hysteresis",
        balance="drive",
        kind="torque",
        meaning="presliding that builds up step by step: elements that slip one after the other",
        equation="sum_i F_i z_i, dz_i = dtheta_out / (w u_i) while |z_i| < 1, u = 1, 3, 9, 27",
        source="Iwan (1966), J. Appl. Mech. 33(4); Al-Bender, Lampaert & Swevers (2005), IEEE TAC 50(11)",
        amplitudes=tuple(
            Parameter(f"force_{i + 1}", "N m", f"torque at which element {i + 1} slips", 0.0, 1e5)
            for i in range(len(ELEMENT_WIDTHS))
        ),
        shapes=(
            Parameter(
                "width", "rad", "output angle at which the first element slips", 1e-5, 0.1, 1e-4, "", (3e-5, 3e-4, 3e-3)
            ),
        ),
        columns=_maxwell_slip,
        slips=ELEMENT_WIDTHS,
        refines=("coulomb_friction",),
    ),
)

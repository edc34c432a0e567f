"""The drive balance: motor torque or current against the motion of one encoder.

Amplitudes carry the unit of the balance: N m of motor torque, or A where only the current is known (written `N m`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.effects.algebra import (
    direction,
    rubbing,
    stack,
    stop_operator,
    stop_operators,
    swing_gain,
    swung,
)
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.friction import (
    BRISTLE_DAMPING,
    FADING,
    OUTPUT_STRIBECK_SPEED,
    STATIC_RATIO,
    STRIBECK_EXPONENT,
    STRIBECK_LEVELS,
    stribeck_bump,
    warmth,
)
from edge_daemon.effects.presliding import bristles
from edge_daemon.records import Array, Motion

PRESLIDING_WIDTH = Parameter(
    "width",
    "rad",
    "output angle over which the friction builds up",
    1e-5,
    0.5,
    1e-3,
    "",
    (1e-4, 1e-3, 1e-2, 0.1),
)
ELEMENT_WIDTHS = (1.0, 3.0, 9.0, 27.0)
"""Widths of the presliding elements over that of the narrowest: a threefold step leaves 3 % of a smooth curve."""


def _inertia(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.acceleration_out_rad_s2), state


def _elastic(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    difference, state = swung(
        motion.acceleration_out_rad_s2, motion.rate_hz, shape["frequency"], shape["damping"], state
    )
    return stack(difference), state


def _elastic_gain(frequency_hz: Array, shape: Mapping[str, float]) -> NDArray[np.complex128]:
    return swing_gain(frequency_hz, shape["frequency"], shape["damping"])


def _viscous(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.velocity_out_rad_s), state


def _coulomb(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(direction(motion)), state


def _asymmetric(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    sign = direction(motion)
    return stack((1 + sign) / 2, (sign - 1) / 2), state


def _stribeck(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    bump = stribeck_bump(motion.velocity_out_rad_s, shape)
    return stack(direction(motion), rubbing(motion) * bump), state


def _power_of_speed(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(direction(motion) * np.abs(motion.velocity_out_rad_s) ** shape["exponent"]), state


def _model_torque(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.extra["torque_model_Nm"]), state


def _constant(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.ones(len(motion))), state


def _gravity(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.sin(motion.theta_out_rad), np.cos(motion.theta_out_rad)), state


def _varying_inertia(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    columns, swing = [], motion.velocity_out_rad_s**2 / 2
    for order in INERTIA_ORDERS:
        sine, cosine = np.sin(order * motion.theta_out_rad), np.cos(order * motion.theta_out_rad)
        columns.append(sine * motion.acceleration_out_rad_s2 + order * cosine * swing)
        columns.append(cosine * motion.acceleration_out_rad_s2 - order * sine * swing)
    return stack(*columns), state


def _thermal(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(warmth(motion, shape) * motion.velocity_out_rad_s), state


def _maxwell_slip(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    slips = state if state is not None else (None,) * len(ELEMENT_WIDTHS)
    rows = stop_operators(motion.theta_out_rad, [shape["width"] * times for times in ELEMENT_WIDTHS], slips)
    return stack(*(z for z, _ in rows)), tuple(slip for _, slip in rows)


def _lugre(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    bent, speed = bristles(motion, shape, state), motion.velocity_out_rad_s
    return stack(bent.level * bent.share, speed - np.abs(speed) * bent.share), bent.state


def _dahl(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    bent = bristles(motion, shape, state)
    return stack(bent.share), bent.state


def _hysteresis(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    z, state = stop_operator(motion.theta_out_rad, shape["width"], state)
    return stack(z), state


INERTIA_ORDERS = (1, 2)
"""Of an inertia that varies over a turn: a crank's mass varies once and twice, what hangs on a bent joint once."""
_LEVEL = Parameter("friction", "N m", "friction torque", 0.0, 1e5)
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
        meaning="what the robot's controller reckons for this joint, or a sensor behind the gear measures: inertia, "
        "gravity and coupling of all joints",
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
        name="joint_elasticity",
        balance="drive",
        kind="torque",
        meaning="a load that swings on the spring of the gear: near its resonance the motor feels more of it than its "
        "inertia, beyond hardly any",
        equation="J_l (alpha_l - alpha_out), alpha_l / alpha_out = (2 d w s + w^2) / (s^2 + 2 d w s + w^2)",
        source="Spong (1987), J. Dyn. Syst. Meas. Control 109(4): two masses; Tuttle (1992), MIT AI-TR 1365: resonance",
        amplitudes=(Parameter("inertia", "N m s^2/rad", "of what swings, part of the whole inertia", 0.0, 1e6),),
        shapes=(
            Parameter(
                "frequency",
                "Hz",
                "at which the load swings where the motor is held",
                2.0,
                400.0,
                20.0,
                "",
                tuple(3.0 * 1.2**k for k in range(19)),
            ),
            Parameter("damping", "1", "of that swing, over the critical", 0.01, 1.0, 0.1, "", (0.1,)),
        ),
        columns=_elastic,
        filters=_elastic_gain,
        carried=True,
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
        equation="(F_c + F_e exp(-|omega_out / v_st|^n)) sgn(omega_out), n = 2 or 1; "
        "beside presliding F_e builds up as that does",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7): n = 2; Tustin (1947), "
        "J. Inst. Electr. Eng. 94(2A): n = 1",
        amplitudes=STRIBECK_LEVELS,
        shapes=(OUTPUT_STRIBECK_SPEED, STRIBECK_EXPONENT),
        columns=_stribeck,
        rubs=True,
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
        yields_to=("constant_torque", "constant_load", "model_torque"),
    ),
    Effect(
        name="constant_load",
        balance="drive",
        kind="torque",
        meaning="a steady torque that passes the gear: a weight on a belt, a spring, the zero of a model torque",
        equation="tau_0, told from a constant torque by friction of the load alone",
        source="Newton: torque balance at rest",
        amplitudes=(Parameter("load", "N m", "motor torque that holds the load at rest"),),
        shapes=(),
        columns=_constant,
        refines=("constant_torque",),
        steady="exactly",
        carried=True,
    ),
    Effect(
        name="varying_inertia",
        balance="drive",
        kind="torque",
        meaning="inertia that varies with the output angle, and what that costs at speed: a crank, a linkage",
        equation="J(theta_out) alpha_out + dJ/dtheta omega_out^2 / 2, J = sum_m s_m sin(m theta_out) + "
        "c_m cos(m theta_out), m = 1, 2",
        source="Lagrange's equation of one joint, e.g. Featherstone (2008), chapter 3",
        amplitudes=tuple(
            Parameter(
                f"{word}_{order}", "N m s^2/rad", f"{word} part of the inertia, {order} times per turn of the output"
            )
            for order in INERTIA_ORDERS
            for word in ("sine", "cosine")
        ),
        shapes=(),
        columns=_varying_inertia,
        carried=True,
        yields_to=("model_torque", "gravity_load"),
    ),
    Effect(
        name="temperature_friction",
        balance="drive",
        kind="torque",
        meaning="viscous friction that changes with the temperature of the housing",
        equation="b_T (1 - exp(-k (T - 25 degC))) / k omega_out",
        source="Bittencourt & Gunnarsson (2012), ASME J. Dyn. Sys. Meas. Control 134(5): drag falls exponentially",
        amplitudes=(Parameter("slope", "N m s/(rad K)", "change of viscous friction per kelvin, at 25 degC"),),
        shapes=(FADING,),
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
        shapes=(PRESLIDING_WIDTH,),
        columns=_hysteresis,
        slips=(1.0,),
        refines=("coulomb_friction",),
    ),
    Effect(
        name="dahl_friction",
        balance="drive",
        kind="torque",
        meaning="dry friction that builds up ever more slowly over the angle after a reversal",
        equation="F z, w dz = dtheta_out - |dtheta_out| z",
        source="Dahl (1968), Aerospace Corp. TOR-0158(3107-18)-1",
        amplitudes=(_LEVEL,),
        shapes=(PRESLIDING_WIDTH,),
        columns=_dahl,
        is_bristles=True,
        slips=(1.0,),
        refines=("coulomb_friction",),
        yields_to=("hysteresis",),
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
    Effect(
        name="lugre_friction",
        balance="drive",
        kind="torque",
        meaning="bristles: presliding over a small angle, up to a level that falls with speed",
        equation="F_c z + s_1 w dz/dt, w dz = dtheta_out - |dtheta_out| z / g, "
        "g = 1 + (r - 1) exp(-|omega_out / v_st|^n)",
        source="Canudas de Wit, Olsson, Astrom & Lischinsky (1995), IEEE TAC 40(3), eq. 1-3",
        amplitudes=(_LEVEL, BRISTLE_DAMPING),
        shapes=(
            replace(PRESLIDING_WIDTH, grid=(1e-3, 1e-2)),
            STATIC_RATIO,
            replace(OUTPUT_STRIBECK_SPEED, grid=(0.05, 0.15, 0.4)),
            STRIBECK_EXPONENT,
        ),
        columns=_lugre,
        is_bristles=True,
        refines=("coulomb_friction", "stribeck_friction", "hysteresis", "dahl_friction", "maxwell_slip_hysteresis"),
    ),
)

"""The drive balance: motor torque or current against the motion of one encoder.

Amplitudes carry the unit of the balance: N m of motor torque, or A where only the current is known (written `N m`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from edge_daemon.effects.algebra import MOTOR_ORDERS, harmonic_parameters, harmonics, smooth_sign, stack, stop_operator
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.effects.stiffness import REFERENCE_DEGC
from edge_daemon.records import Array, Motion

SMOOTHING = Parameter(
    "smoothing", "rad/s", "output speed at which the sign has reached tanh(1)", 1e-4, 0.3, 1e-2, "", (0.003, 0.02)
)


def _sign(motion: Motion, shape: Mapping[str, float]) -> Array:
    return smooth_sign(motion.velocity_out_rad_s, shape["smoothing"])


def _inertia(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.acceleration_out_rad_s2), state


def _viscous(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.velocity_out_rad_s), state


def _coulomb(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(_sign(motion, shape)), state


def _asymmetric(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    sign = _sign(motion, shape)
    return stack((1 + sign) / 2, (sign - 1) / 2), state


def _stribeck(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    sign = _sign(motion, shape)
    return stack(sign, sign * np.exp(-((motion.velocity_out_rad_s / shape["stribeck_speed"]) ** 2))), state


def _sublinear(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(_sign(motion, shape) * np.abs(motion.velocity_out_rad_s) ** shape["exponent"]), state


def _load_dependent(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.abs(motion.acceleration_out_rad_s2) * _sign(motion, shape)), state


def _gravity(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.sin(motion.theta_out_rad), np.cos(motion.theta_out_rad)), state


def _ripple(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    waves = harmonics(motion.theta_in_rad, MOTOR_ORDERS)
    return np.hstack((waves, _sign(motion, shape)[:, None] * waves)), state


def _thermal(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack((motion.temperature_degC - REFERENCE_DEGC) * motion.velocity_out_rad_s), state


def _hysteresis(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    z, state = stop_operator(motion.theta_out_rad, shape["width"], state)
    return stack(z), state


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
    ),
    Effect(
        name="coulomb_friction",
        balance="drive",
        kind="torque",
        meaning="friction that only knows the direction",
        equation="F_c tanh(omega_out / v_s)",
        source="Coulomb's law, smoothed sign: Andersson, Soderberg & Bjorklund (2007), Tribol. Int. 40(4)",
        amplitudes=(_LEVEL,),
        shapes=(SMOOTHING,),
        columns=_coulomb,
    ),
    Effect(
        name="asymmetric_friction",
        balance="drive",
        kind="torque",
        meaning="friction of a different level in each direction",
        equation="F_p (1 + s)/2 - F_n (1 - s)/2, s = tanh(omega_out / v_s)",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7)",
        amplitudes=(
            Parameter("forward", "N m", "friction torque in positive motion", 0.0, 1e5),
            Parameter("backward", "N m", "friction torque in negative motion", 0.0, 1e5),
        ),
        shapes=(SMOOTHING,),
        columns=_asymmetric,
        refines=("coulomb_friction",),
    ),
    Effect(
        name="stribeck_friction",
        balance="drive",
        kind="torque",
        meaning="friction that is larger at creep than in motion",
        equation="(F_c + F_e exp(-(omega_out / v_st)^2)) tanh(omega_out / v_s)",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7) (Gaussian form)",
        amplitudes=(
            Parameter("friction", "N m", "Coulomb level", 0.0, 1e5),
            Parameter("excess", "N m", "static level above the Coulomb level", 0.0, 1e5),
        ),
        shapes=(
            Parameter(
                "stribeck_speed",
                "rad/s",
                "output speed at which the excess has fallen to 1/e",
                1e-3,
                3.0,
                0.1,
                "velocity_out_rad_s",
                (0.05, 0.15, 0.4, 1.0),
            ),
            SMOOTHING,
        ),
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
        shapes=(Parameter("exponent", "1", "power of the speed", 0.1, 0.95, 0.5, "", (0.3, 0.5, 0.67)), SMOOTHING),
        columns=_sublinear,
        refines=("viscous_friction", "coulomb_friction"),
    ),
    Effect(
        name="load_dependent_friction",
        balance="drive",
        kind="torque",
        meaning="friction that grows with the torque that accelerates the load",
        equation="m |alpha_out| tanh(omega_out / v_s)",
        source="Taghirad & Belanger (1998), ASME J. Dyn. Sys. Meas. Control 120(4)",
        amplitudes=(Parameter("coefficient", "N m s^2/rad", "friction torque per output acceleration", 0.0, 1e5),),
        shapes=(SMOOTHING,),
        columns=_load_dependent,
        refines=("coulomb_friction",),
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
    ),
    Effect(
        name="wave_generator_ripple",
        balance="drive",
        kind="torque",
        meaning="torque that repeats with the wave generator, different in each direction",
        equation="sum_m (s_m + t_m sgn omega) sin(m theta_in) + (c_m + d_m sgn omega) cos(m theta_in), m = 1, 2, 4",
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=harmonic_parameters("N m", MOTOR_ORDERS, "wave generator angle")
        + tuple(
            Parameter(f"{word}_{m}_directed", "N m", f"{word} part that changes sign with the motion, order {m}")
            for m in MOTOR_ORDERS
            for word in ("sine", "cosine")
        ),
        shapes=(SMOOTHING,),
        columns=_ripple,
    ),
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
        refines=("coulomb_friction",),
    ),
)

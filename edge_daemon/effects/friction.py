"""Torques that follow a rate. Names without prefix act on the twist rate, `output_` on the output speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from edge_daemon.effects.algebra import bristle_state, smooth_sign, stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Twin
from edge_daemon.effects.stiffness import REFERENCE_DEGC
from edge_daemon.integrator.laws import BRISTLE, BUMP, LOADED, RUB, SIGN, Element
from edge_daemon.records import Array, Motion

SMOOTHING = Parameter(
    "smoothing", "rad/s", "twist rate at which the sign has reached tanh(1)", 1e-6, 2e-2, 1e-3, "", (1e-4, 1e-3)
)
FADING = Parameter(
    "fading",
    "1/K",
    "by how much of itself a change per kelvin falls in each: 0 of a straight line, 0.02 to 0.06 of greases and oils",
    0.0,
    0.15,
    0.0,
    "",
    (0.0, 0.03, 0.06),
)


def _viscous(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.twist_rate_rad_s), state


def _coulomb(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(smooth_sign(motion.twist_rate_rad_s, shape["smoothing"])), state


def _stribeck(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    sign = smooth_sign(motion.twist_rate_rad_s, shape["smoothing"])
    return stack(sign, sign * stribeck_bump(motion.twist_rate_rad_s, shape)), state


def stribeck_bump(speed: Array, shape: Mapping[str, float]) -> Array:
    """(n,) share of the excess that is left at a speed or twist rate (n,) [rad/s]."""
    return np.asarray(np.exp(-(np.abs(speed / shape["stribeck_speed"]) ** shape.get("exponent", GAUSSIAN))))


def _lugre(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    level = 1 + (shape["static_ratio"] - 1) * stribeck_bump(motion.twist_rate_rad_s, shape)
    reach = np.full(len(motion), shape["presliding"])
    bristles, state = bristle_state(motion.twist_rad, reach, level, state)
    rate = motion.twist_rate_rad_s
    return stack(bristles, rate - np.abs(rate) * bristles / level), state


def _dahl(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    level = np.ones(len(motion))
    bristles, state = bristle_state(motion.twist_rad, shape["presliding"] * level, level, state)
    return stack(bristles), state


def _load_dependent(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(np.abs(motion.torque_Nm) * smooth_sign(motion.twist_rate_rad_s, shape["smoothing"])), state


def _thermal(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(warmth(motion, shape) * motion.twist_rate_rad_s), state


def warmth(motion: Motion, shape: Mapping[str, float]) -> Array:
    """(n,) kelvins above 25 degC by which an oil has thinned, each less than the one before."""
    fading = max(shape["fading"], 1e-9)
    return np.asarray(-np.expm1(-fading * (motion.temperature_degC - REFERENCE_DEGC)) / fading)


def _output_viscous(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(-motion.velocity_out_rad_s), state


def _output_coulomb(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(-smooth_sign(motion.velocity_out_rad_s, shape["smoothing"])), state


def _coulomb_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(SIGN, a[0], shape["smoothing"]),)


def _stribeck_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    smoothing = shape["smoothing"]
    return Element(SIGN, a[0], smoothing), Element(BUMP, a[1], smoothing, shape["stribeck_speed"])


def _lugre_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    own = shape["presliding"], shape["static_ratio"], shape["stribeck_speed"]
    return Element(BRISTLE, a[0], *own), Element(RUB, a[1], *own)


def _dahl_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(BRISTLE, a[0], shape["presliding"], 1.0),)


def _loaded_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(LOADED, a[0], shape["smoothing"]),)


_LEVEL = Parameter("friction", "N m", "friction torque", 0.0, 1e5)
PRESLIDING = Parameter(
    "presliding", "rad", "twist over which the bristles load up", 1e-8, 1e-2, 1e-5, "twist_rad", (0.01, 0.05, 0.2)
)
GAUSSIAN = 2.0
"""Exponent of the speed by which the excess falls, where a law has no shape for it."""
BRISTLE_DAMPING = Parameter("bristle_damping", "N m s/rad", "torque per rate at which the bristles bend", 0.0, 1e5)
STATIC_RATIO = Parameter("static_ratio", "1", "static over Coulomb level", 1.0, 4.0, 1.3, "", (1.3,))
STRIBECK_LEVELS = (
    Parameter("friction", "N m", "Coulomb level", 0.0, 1e5),
    Parameter("excess", "N m", "static level above the Coulomb level", 0.0, 1e5),
)
STRIBECK_SPEED = Parameter(
    "stribeck_speed",
    "rad/s",
    "twist rate at which the excess has fallen to 1/e",
    1e-5,
    1e-1,
    5e-3,
    "twist_rate_rad_s",
    (0.15, 0.35, 0.8),
)
STRIBECK_EXPONENT = Parameter(
    "exponent", "1", "power of the speed in the fall of the excess", 0.5, 3.0, GAUSSIAN, choices=(GAUSSIAN, 1.0)
)
OUTPUT_STRIBECK_SPEED = replace(
    STRIBECK_SPEED,
    meaning="output speed at which the excess has fallen to 1/e",
    lower=1e-3,
    upper=3.0,
    start=0.1,
    scale="velocity_out_rad_s",
    grid=(0.05, 0.15, 0.4, 1.0),
)

ROWS = (
    Effect(
        name="viscous_damping",
        balance="torsion",
        kind="torque",
        meaning="damping of the twist; viscous friction of the twist is the same column and included",
        equation="B dphi/dt",
        source="Tuttle (1992), MIT AI-TR 1365",
        amplitudes=(Parameter("damping", "N m s/rad", "torque per twist rate", 0.0, 1e6, 5.0),),
        shapes=(),
        columns=_viscous,
        needs=("twist_rad",),
        follows="twist_rate_rad_s",
    ),
    Effect(
        name="coulomb_friction",
        balance="torsion",
        kind="torque",
        meaning="friction of the twist that only knows the direction",
        equation="F_c tanh(dphi/dt / v_s)",
        source="Coulomb's law, smoothed sign: Andersson, Soderberg & Bjorklund (2007), Tribol. Int. 40(4)",
        amplitudes=(_LEVEL,),
        shapes=(SMOOTHING,),
        columns=_coulomb,
        in_loop=_coulomb_law,
        needs=("twist_rad",),
    ),
    Effect(
        name="stribeck_friction",
        balance="torsion",
        kind="torque",
        meaning="friction of the twist that is larger at creep than in motion",
        equation="(F_c + F_e exp(-(dphi/dt / v_st)^2)) tanh(dphi/dt / v_s)",
        source="Armstrong-Helouvry, Dupont & Canudas de Wit (1994), Automatica 30(7) (Gaussian form)",
        amplitudes=STRIBECK_LEVELS,
        shapes=(
            replace(STRIBECK_SPEED, quantity="stribeck_speed"),
            SMOOTHING,
        ),
        columns=_stribeck,
        in_loop=_stribeck_law,
        needs=("twist_rad",),
        refines=("coulomb_friction",),
    ),
    Effect(
        name="lugre_friction",
        balance="torsion",
        kind="torque",
        meaning="bristles: friction with presliding displacement and a Stribeck level",
        equation="F_c z + s_1 d dz/dt, d dz = dphi - |dphi| z / g, g = 1 + (r - 1) exp(-(dphi/dt / v_st)^2)",
        source="Canudas de Wit, Olsson, Astrom & Lischinsky (1995), IEEE TAC 40(3), eq. 1-3",
        amplitudes=(_LEVEL, BRISTLE_DAMPING),
        shapes=(PRESLIDING, STATIC_RATIO, STRIBECK_SPEED),
        columns=_lugre,
        in_loop=_lugre_law,
        needs=("twist_rad",),
        refines=("coulomb_friction", "stribeck_friction", "dahl_friction"),
    ),
    Effect(
        name="dahl_friction",
        balance="torsion",
        kind="torque",
        meaning="friction that builds up over a small twist after a reversal, as a material yields",
        equation="F_c z, d dz = dphi - |dphi| z",
        source="Dahl (1968), Aerospace Corp. TOR-0158(3107-18)-1; Dahl (1976), AIAA J. 14(12), exponent 1",
        amplitudes=(_LEVEL,),
        shapes=(replace(PRESLIDING, grid=(0.02, 0.1, 0.3)),),
        columns=_dahl,
        in_loop=_dahl_law,
        needs=("twist_rad",),
        refines=("coulomb_friction",),
    ),
    Effect(
        name="load_dependent_friction",
        balance="torsion",
        kind="torque",
        meaning="friction of the teeth, which grows with the torque that passes them",
        equation="mu |tau| tanh(dphi/dt / v_s), tau the whole torque that reaches the output, this friction included",
        source="Amontons' law with the force between the teeth in proportion to the torque that they pass on; "
        "Taghirad & Belanger (1998), ASME J. Dyn. Sys. Meas. Control 120(4)",
        amplitudes=(Parameter("coefficient", "1", "friction torque over transmitted torque", 0.0, 1.0),),
        shapes=(SMOOTHING,),
        columns=_load_dependent,
        in_loop=_loaded_law,
        needs=("twist_rad",),
    ),
    Effect(
        name="temperature_friction",
        balance="torsion",
        kind="torque",
        meaning="damping that changes with the temperature of the housing: the lubricant",
        equation="b_T (1 - exp(-k (T - 25 degC))) / k dphi/dt",
        source="Bittencourt & Gunnarsson (2012), ASME J. Dyn. Sys. Meas. Control 134(5): drag falls exponentially",
        amplitudes=(Parameter("slope", "N m s/(rad K)", "change of damping per kelvin, at 25 degC"),),
        shapes=(FADING,),
        columns=_thermal,
        needs=("twist_rad", "temperature_degC"),
    ),
    Effect(
        name="output_viscous_friction",
        balance="torsion",
        kind="torque",
        meaning="viscous friction of the output bearing and seal",
        equation="-c omega_out",
        source="Harnoy (2002), Bearing Design in Machinery (viscous shear)",
        amplitudes=(Parameter("coefficient", "N m s/rad", "torque per output speed", 0.0, 1e5),),
        shapes=(),
        columns=_output_viscous,
        told_by="output",
        twins=(
            Twin(
                "encoder_skew",
                "repeat with both encoders latched by one signal: a skew vanishes, friction stays",
            ),
        ),
        yields_to=("encoder_skew",),
    ),
    Effect(
        name="output_coulomb_friction",
        balance="torsion",
        kind="torque",
        meaning="dry friction of the output bearing and seal",
        equation="-F_o tanh(omega_out / v_s)",
        source="Coulomb's law, smoothed sign: Andersson, Soderberg & Bjorklund (2007), Tribol. Int. 40(4)",
        amplitudes=(_LEVEL,),
        shapes=(
            Parameter(
                "smoothing", "rad/s", "output speed at which the sign has reached tanh(1)", 1e-4, 0.1, 1e-2, "", (1e-2,)
            ),
        ),
        columns=_output_coulomb,
        told_by="output",
    ),
)

"""Torques that follow the twist: springs of every shape."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from edge_daemon.effects.algebra import stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Wave
from edge_daemon.effects.waves import in_words, of_input, wave_parameters, waves
from edge_daemon.integrator.laws import CLIP, CURVES, SPRING, Element
from edge_daemon.records import Array, Motion

REFERENCE_DEGC = 25.0
"""The temperature effects vanish here."""
SLOPE_STEP = 1e-3
"""A spring that bends is derived over this share of the twist's rms to either side."""


def _linear(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.twist_rad), state


def _polynomial(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack(motion.twist_rad**2, motion.twist_rad**3), state


def _beyond(twist: Array, corner: float) -> Array:
    """The twist less its first `corner` radians, on either side."""
    return twist - np.clip(twist, -corner, corner)


def _piecewise(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    first = shape["corner_1"]
    return stack(
        _beyond(motion.twist_rad, first),
        _beyond(motion.twist_rad, first + shape["corner_gap"]),
    ), state


def _backlash(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    half = shape["half_gap"]
    return stack(-shape["stiffness"] * np.clip(motion.twist_rad, -half, half)), state


def _mesh(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    return motion.twist_rad[:, None] * waves(motion, rows), state


def _thermal(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return stack((motion.temperature_degC - REFERENCE_DEGC) * motion.twist_rad), state


def _polynomial_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(SPRING, 0.0, a[0], a[1]),)


def _piecewise_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    first = shape["corner_1"]
    beyond = Element(SPRING, a[0] + a[1], 0.0, 0.0)
    return beyond, Element(CLIP, -a[0], first), Element(CLIP, -a[1], first + shape["corner_gap"])


def _backlash_law(shape: Mapping[str, float], a: Sequence[float]) -> tuple[Element, ...]:
    return (Element(CLIP, -a[0] * shape["stiffness"], shape["half_gap"]),)


def bends(effect: Effect) -> bool:
    """Whether it is a spring whose torque is a curve of the twist."""
    return bool(effect.law) and {element.kind for element in effect.law} <= CURVES


def slope(effect: Effect, motion: Motion, shape: Mapping[str, float]) -> Array:
    """(n, k) derivative of an effect's columns to the twist."""
    step = SLOPE_STEP * math.sqrt(float(np.mean(motion.twist_rad**2))) + 1e-15
    after, before = (replace(motion, twist_rad=motion.twist_rad + side * step) for side in (1.0, -1.0))
    rise = effect.columns(after, shape, None)[0] - effect.columns(before, shape, None)[0]
    return np.asarray(rise / (2.0 * step))


def mesh_stiffness(rows: tuple[Wave, ...]) -> Effect:
    """Stiffness that repeats, over some waves."""
    return Effect(
        name="mesh_stiffness",
        balance="torsion",
        kind="torque",
        meaning="stiffness that changes as the wave generator turns, or from tooth to tooth",
        equation=f"sum_m (s_m sin(m theta) + c_m cos(m theta)) phi, {in_words(rows)}",
        source="Kircanski & Goldenberg (1997), Int. J. Robotics Research 16(2) (measured joint stiffness)",
        amplitudes=wave_parameters("N m/rad", rows, "input"),
        shapes=(),
        columns=partial(_mesh, rows),
        needs=("twist_rad", "theta_in_rad"),
        waves=rows,
        carriers=("twist_rad",),
        over=mesh_stiffness,
    )


ROWS = (
    Effect(
        name="linear_stiffness",
        balance="torsion",
        kind="torque",
        meaning="the gear as a linear torsion spring",
        equation="K phi",
        source="Tuttle (1992), MIT AI-TR 1365",
        amplitudes=(Parameter("stiffness", "N m/rad", "torque per twist at zero twist", 0.0, 1e8, 2e4),),
        shapes=(),
        columns=_linear,
        needs=("twist_rad",),
        told_by="stiffness",
        follows="twist_rad",
        is_spring=True,
    ),
    Effect(
        name="polynomial_stiffness",
        balance="torsion",
        kind="torque",
        meaning="a spring that stiffens or softens smoothly with twist",
        equation="k1 phi^2 + k2 phi^3",
        source="Tuttle (1992), MIT AI-TR 1365 (cubic spring); even term for an unsymmetric gear",
        amplitudes=(
            Parameter("k1", "N m/rad^2", "change of stiffness per twist"),
            Parameter("k2", "N m/rad^3", "change of stiffness per squared twist"),
        ),
        shapes=(),
        columns=_polynomial,
        in_loop=_polynomial_law,
        needs=("twist_rad",),
        told_by="corners",
        is_spring=True,
    ),
    Effect(
        name="piecewise_stiffness",
        balance="torsion",
        kind="torque",
        meaning="the makers' three straight stiffness ranges K1, K2, K3",
        equation="(K2-K1) beyond(phi, c1) + (K3-K2) beyond(phi, c1+g), beyond(x, c) = x - clip(x, -c, c)",
        source="Harmonic Drive CSF/CSG catalogue, torsional stiffness table (p. 49)",
        amplitudes=(
            Parameter("rise_1", "N m/rad", "K2 - K1"),
            Parameter("rise_2", "N m/rad", "K3 - K2"),
        ),
        shapes=(
            Parameter("corner_1", "rad", "twist at the torque T1", 1e-7, 1e-2, 2e-4, "twist_rad", (0.3, 0.6, 1.0, 1.5)),
            Parameter("corner_gap", "rad", "further twist to the torque T2", 1e-7, 1e-2, 2e-4, "twist_rad", (0.7,)),
        ),
        columns=_piecewise,
        in_loop=_piecewise_law,
        refines=("backlash",),
        needs=("twist_rad",),
        told_by="corners",
        is_spring=True,
    ),
    Effect(
        name="backlash",
        balance="torsion",
        kind="torque",
        meaning="lost motion: no torque inside a gap",
        equation="-f K clip(phi, -g, g), f = 1 for a true gap",
        source="Nordin & Gutman (2002), Automatica 38(10) (dead zone model)",
        amplitudes=(Parameter("fraction", "1", "share of the stiffness that is lost inside the gap", 0.85, 1.15, 1.0),),
        shapes=(
            Parameter(
                "half_gap",
                "rad",
                "half of the gap",
                1e-7,
                1e-2,
                5e-5,
                "twist_rad",
                (0.05, 0.1, 0.2, 0.3, 0.45, 0.7),
                "half_gap",
            ),
            Parameter("stiffness", "N m/rad", "stiffness outside the gap", 0.0, 1e8, 2e4),
        ),
        columns=_backlash,
        in_loop=_backlash_law,
        needs=("twist_rad",),
        tied={"stiffness": ("linear_stiffness", "stiffness")},
        told_by="corners",
        is_spring=True,
    ),
    mesh_stiffness(of_input(2)),
    Effect(
        name="temperature_stiffness",
        balance="torsion",
        kind="torque",
        meaning="stiffness that changes with the temperature of the housing",
        equation="k_T (T - 25 degC) phi",
        source="linear term of a Taylor series; steel alone gives -0.03 %/K",
        amplitudes=(Parameter("slope", "N m/(rad K)", "change of stiffness per kelvin"),),
        shapes=(),
        columns=_thermal,
        needs=("twist_rad", "temperature_degC"),
    ),
)

"""What repeats with an angle, and sensor errors that disguise themselves as twist.

An additive error e of the twist makes the torque K e + B de/dt: the columns hold K and B of the same model as tied
shapes, so that the amplitudes are angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from edge_daemon.channels import MOTOR_ORDERS
from edge_daemon.effects.algebra import derivative, inertia_of, stack
from edge_daemon.effects.effect import Effect, EffectState, Parameter, Wave
from edge_daemon.effects.waves import in_words, of_input, wave_parameters, wave_rates, wave_slopes, waves
from edge_daemon.records import Array, Motion

RIPPLE_ORDERS = (1, 2)
"""A coupling passes on these orders of motor torque ripple per turn (guess: pole-pair orders are far above)."""


def _error_of_angle(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    return shape["stiffness"] * waves(motion, rows) + shape["damping"] * wave_rates(motion, rows), state


def _error_of_output(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    """An output encoder's error is in the acceleration too, where that is the torque."""
    columns, _ = _error_of_angle(rows, motion, shape, state)
    return columns + motion.inertia_kg_m2 * wave_slopes(motion, rows).lifts if motion.inertia_kg_m2 else columns, state


def _skew(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    """The balance holds at the instant of its torque: of the output angle where the torque is that of the inertia, so
    that the input angle is moved; of the stamps where a sensor measures it, so that the output angle is."""
    speed, acceleration = motion.velocity_out_rad_s, motion.acceleration_out_rad_s2
    if "torque_out_Nm" not in motion.extra:
        speed = speed + motion.twist_rate_rad_s
        acceleration = acceleration + derivative(motion.twist_rate_rad_s, motion.rate_hz)
    return stack(shape["stiffness"] * speed + shape["damping"] * acceleration), state


def _ripple(
    rows: tuple[Wave, ...], motion: Motion, shape: Mapping[str, float], state: EffectState
) -> tuple[Array, EffectState]:
    return waves(motion, rows), state


def felt_error(motion: Motion, error: Array, stiffness: float, damping: float) -> Array:
    """(n, k) torque that an output encoder's errors (n, k) seem, in a torque computed from its acceleration too."""
    rates = np.stack([derivative(column, motion.rate_hz) for column in error.T], axis=1)
    torque = stiffness * error + damping * rates
    if inertia := inertia_of(motion):
        torque += inertia * np.stack([derivative(column, motion.rate_hz) for column in rates.T], axis=1)
    return torque


TIED_SHAPES = (
    Parameter("stiffness", "N m/rad", "stiffness of the same model", 0.0, 1e8, 2e4),
    Parameter("damping", "N m s/rad", "damping of the same model", 0.0, 1e6, 5.0),
)
TIED_TO = {"stiffness": ("linear_stiffness", "stiffness"), "damping": ("viscous_damping", "damping")}


def kinematic_error(rows: tuple[Wave, ...]) -> Effect:
    """The error of the transmission over some waves."""
    return Effect(
        name="kinematic_error",
        balance="torsion",
        kind="measurement",
        meaning="transmission error: the output leads or lags with the angle of the wave generator, or with the teeth",
        equation="K e + B de/dt, of a motor's torque K twist de/dtheta_out besides, e = sum_m s_m sin(m theta) "
        f"+ c_m cos(m theta), {in_words(rows)}",
        source="Ghorbel, Gandhi & Alpeter (2001), ASME J. Mech. Design 123(1); the ratio by d'Alembert's principle",
        amplitudes=wave_parameters("rad", rows, "input"),
        shapes=TIED_SHAPES,
        columns=partial(_error_of_angle, rows),
        needs=("twist_rad", "theta_in_rad"),
        tied=TIED_TO,
        told_by="angle",
        waves=rows,
        over=kinematic_error,
    )


def encoder_eccentricity(rows: tuple[Wave, ...]) -> Effect:
    """The error of the output encoder over some waves."""
    return Effect(
        name="encoder_eccentricity",
        balance="torsion",
        kind="measurement",
        meaning="output encoder mounted off centre: an angle error once per output turn, twice where it is tilted",
        equation=f"K e + B de/dt + J d2e/dt2, e = sum_m s_m sin(m theta) + c_m cos(m theta), {in_words(rows)}",
        source="geometry: a disc whose centre is off the axis by a radius r reads r/R_disc sin(theta) too far",
        amplitudes=wave_parameters("rad", rows, "output"),
        shapes=TIED_SHAPES,
        columns=partial(_error_of_output, rows),
        needs=("twist_rad",),
        tied=TIED_TO,
        misreads="theta_out_rad",
        told_by="angle",
        yields_to=("gravity_load", "constant_load"),
        waves=rows,
        later=(Wave("output", 2.0),),
        over=encoder_eccentricity,
    )


def torque_ripple(rows: tuple[Wave, ...]) -> Effect:
    """Ripple of the output torque over some waves."""
    return Effect(
        name="torque_ripple",
        balance="torsion",
        kind="torque",
        meaning="torque that repeats with the motor angle, seen by a torque sensor on the output",
        equation=f"sum_m s_m sin(m theta) + c_m cos(m theta), {in_words(rows)}",
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=wave_parameters("N m", rows, "input"),
        shapes=(),
        columns=partial(_ripple, rows),
        needs=("theta_in_rad", "torque_out_Nm"),
        waves=rows,
        over=torque_ripple,
    )


ROWS = (
    kinematic_error(of_input(*MOTOR_ORDERS)),
    encoder_eccentricity((Wave("output", 1),)),
    Effect(
        name="encoder_skew",
        balance="torsion",
        kind="measurement",
        meaning="the output encoder is sampled later than the input encoder (negative: earlier)",
        equation="d (K omega_in/R + B domega_in/dt/R); omega_out beside a torque sensor, timed as the input is",
        source="first order Taylor series of a delay on the angle that is moved to the torque's instant",
        amplitudes=(Parameter("delay", "s", "output sample is this much late", -0.02, 0.02),),
        shapes=TIED_SHAPES,
        columns=_skew,
        needs=("twist_rad",),
        tied=TIED_TO,
        told_by="timing",
    ),
    torque_ripple(of_input(*RIPPLE_ORDERS)),
)

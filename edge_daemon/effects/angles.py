"""What repeats with an angle, and sensor errors that disguise themselves as twist.

An additive error e of the twist makes the torque K e + B de/dt: the columns hold K and B of the same model as tied
shapes, so that the amplitudes are angles.
"""

from __future__ import annotations

from collections.abc import Mapping

from edge_daemon.effects.algebra import (
    MOTOR_ORDERS,
    derivative,
    harmonic_parameters,
    harmonic_rates,
    harmonics,
    stack,
)
from edge_daemon.effects.effect import Effect, EffectState, Parameter
from edge_daemon.records import Array, Motion

RIPPLE_ORDERS = (1, 2)
"""orders of motor torque ripple per turn that a coupling passes on (guess: pole-pair orders are far above)"""


def _kinematic(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    omega = motion.ratio * (motion.velocity_out_rad_s + motion.twist_rate_rad_s)
    error = harmonics(motion.theta_in_rad, MOTOR_ORDERS)
    rate = harmonic_rates(motion.theta_in_rad, omega, MOTOR_ORDERS)
    return shape["stiffness"] * error + shape["damping"] * rate, state


def _eccentricity(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    error = harmonics(motion.theta_out_rad, (1,))
    rate = harmonic_rates(motion.theta_out_rad, motion.velocity_out_rad_s, (1,))
    return shape["stiffness"] * error + shape["damping"] * rate, state


def _skew(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    """The balance holds at the instant of its torque: of the output angle where the torque is that of the inertia, so
    that the input angle is moved; of the stamps where a sensor measures it, so that the output angle is."""
    speed, acceleration = motion.velocity_out_rad_s, motion.acceleration_out_rad_s2
    if "torque_out_Nm" not in motion.extra:
        speed = speed + motion.twist_rate_rad_s
        acceleration = acceleration + derivative(motion.twist_rate_rad_s, motion.rate_hz)
    return stack(shape["stiffness"] * speed + shape["damping"] * acceleration), state


def _ripple(motion: Motion, shape: Mapping[str, float], state: EffectState) -> tuple[Array, EffectState]:
    return harmonics(motion.theta_in_rad, RIPPLE_ORDERS), state


_SHAPES = (
    Parameter("stiffness", "N m/rad", "stiffness of the same model", 0.0, 1e8, 2e4),
    Parameter("damping", "N m s/rad", "damping of the same model", 0.0, 1e6, 5.0),
)
_TIED = {"stiffness": ("linear_stiffness", "stiffness"), "damping": ("viscous_damping", "damping")}

ROWS = (
    Effect(
        name="kinematic_error",
        balance="torsion",
        kind="measurement",
        meaning="transmission error: the output leads or lags with the angle of the wave generator",
        equation="K e + B de/dt, e = sum_m s_m sin(m theta_in) + c_m cos(m theta_in), m = 1, 2, 4",
        source="Ghorbel, Gandhi & Alpeter (2001), ASME J. Mech. Design 123(1)",
        amplitudes=harmonic_parameters("rad", MOTOR_ORDERS, "motor angle"),
        shapes=_SHAPES,
        columns=_kinematic,
        needs=("twist_rad", "theta_in_rad"),
        tied=_TIED,
    ),
    Effect(
        name="encoder_eccentricity",
        balance="torsion",
        kind="measurement",
        meaning="output encoder mounted off centre: an angle error once per output turn",
        equation="K e + B de/dt, e = s sin(theta_out) + c cos(theta_out)",
        source="geometry: a disc whose centre is off the axis by a radius r reads r/R_disc sin(theta) too far",
        amplitudes=harmonic_parameters("rad", (1,), "output angle"),
        shapes=_SHAPES,
        columns=_eccentricity,
        needs=("twist_rad",),
        tied=_TIED,
    ),
    Effect(
        name="encoder_skew",
        balance="torsion",
        kind="measurement",
        meaning="the output encoder is sampled later than the input encoder (negative: earlier)",
        equation="d (K omega_in/R + B domega_in/dt/R); omega_out beside a torque sensor, timed as the input is",
        source="first order Taylor series of a delay on the angle that is moved to the torque's instant",
        amplitudes=(Parameter("delay", "s", "output sample is this much late", -0.02, 0.02),),
        shapes=_SHAPES,
        columns=_skew,
        needs=("twist_rad",),
        tied=_TIED,
    ),
    Effect(
        name="torque_ripple",
        balance="torsion",
        kind="torque",
        meaning="torque that repeats with the motor angle, seen by a torque sensor on the output",
        equation="sum_m s_m sin(m theta_in) + c_m cos(m theta_in), m = 1, 2",
        source="Tuttle (1992), MIT AI-TR 1365 (velocity-dependent ripple measured on harmonic drives)",
        amplitudes=harmonic_parameters("N m", RIPPLE_ORDERS, "motor angle"),
        shapes=(),
        columns=_ripple,
        needs=("theta_in_rad", "torque_out_Nm"),
    ),
)

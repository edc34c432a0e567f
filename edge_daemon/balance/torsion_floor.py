"""What the noise of encoders and torque leaves of a torsion balance behind its filter."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.motion.kinematics import FirSet
from edge_daemon.records import Array


def channel_noise(trial: PreparedMotion) -> float:
    """rms that the white noise of a measured torque leaves behind the balance filter."""
    return trial.sensors.torque * math.sqrt(float(np.sum(trial.fir.value**2)))


def noise_floor(trial: PreparedMotion, inertia: float, stiffness: float, damping: float, rotor: float = 0.0) -> float:
    """rms [N m] that encoder noise alone leaves in the torsion balance behind its filter, with an inertia at the output
    or a rotor at the motor.

    S(f) = |J s^2 + B s + K|^2 s_out^2 + |J_m s^2 + B s + K|^2 s_in^2, integrated over the pass band by its moments.
    """
    _, m2, m4 = trial.moments
    sizes = np.array([stiffness, damping, rotor])
    load = (inertia * trial.sensors.shaken) ** 2 * m4 - 2 * stiffness * inertia * m2
    load *= trial.sensors.theta_out_rad**2
    return math.sqrt(max(float(sizes @ noise_products(trial) @ sizes) + load, 0.0))


def noise_products(trial: PreparedMotion) -> Array:
    """(3, 3) mean products of the encoders' noise in twist, twist rate and the motor's acceleration as seen from the
    output. An acceleration hears what moves both angles, too."""
    m0, m2, m4 = trial.moments
    into = (trial.sensors.theta_in_rad / trial.motion.ratio) ** 2
    both = into + trial.sensors.theta_out_rad**2
    accelerated = m4 * into * trial.sensors.shaken**2
    return np.array([[m0 * both, 0.0, -m2 * into], [0.0, m2 * both, 0.0], [-m2 * into, 0.0, accelerated]])


def moments(fir: FirSet) -> tuple[float, float, float]:
    """Mean of the filter's power gain times omega^0, omega^2 and omega^4 over all frequencies."""
    omega = 2 * math.pi * np.linspace(0.0, fir.rate_hz / 2, 800)
    wave = np.cos(np.outer(omega / fir.rate_hz, np.arange(-fir.delay, fir.delay + 1)))
    gain = (wave @ fir.value) ** 2
    return float(np.mean(gain)), float(np.mean(gain * omega**2)), float(np.mean(gain * omega**4))

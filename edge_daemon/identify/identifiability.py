"""How much of a torque that a model does not know would show in what it leaves.

A law in the loop sees a simulated twist that is held near the measured one. One that is steep there (a sign as wide as
the motion, a loop that never slips) can take up any torque and leaves little of it: its small residual says nothing.
So an unknown torque is added to the recording, and what of it is left tells how far the residual can be believed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_daemon.balance.prepared import PreparedMotion
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution
from edge_daemon.identify.structure import Structure, loop_inertia
from edge_daemon.records import Array

SHARE = 0.02
"""This share of the torque's rms is enough above rounding, and too little to change what sticks and what slips."""
TONES_HZ = (1.1, 2.3, 4.7, 8.9, 14.3, 23.0)
"""The added torque has these tones: where motion and residuals are, below the torsional resonance."""


@np.errstate(over="ignore", invalid="ignore")  # a loop that runs away is seen by what comes of it
def identifiability(problem: RegressionProblem, solution: Solution) -> float:
    """rms of the change of the residual over that of a torque added to the recording of `problem`: 1 where all of it
    shows, 0 where the model takes it up, or runs away."""
    other = RegressionProblem([_with_unknown(trial, solution) for trial in problem.trials])
    other.tied = dict(problem.tied)
    before = problem.target - _modelled(problem, solution)
    after = other.target - _modelled(other, solution)
    added = np.concatenate([trial.project(_unknown(trial)[0].imag[:, None])[:, 0] for trial in problem.trials])
    shows = math.sqrt(float(np.mean((after - before) ** 2) / np.mean(added**2)))
    return shows if math.isfinite(shows) else 0.0


def _modelled(problem: RegressionProblem, solution: Solution) -> Array:
    loop = Structure(problem, solution)
    return loop.modelled(loop.point, derive=False)[0]


def _unknown(trial: PreparedMotion) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """(n,) torque [N m] at the full rate, as the imaginary part of a sum of tones, and (tones, n) the tones."""
    t = trial.motion.time_s - trial.motion.time_s[0]
    size = SHARE * math.sqrt(float(np.mean(trial.target**2)) / (len(TONES_HZ) / 2))
    tones = np.array([size * np.exp(1j * (2 * math.pi * f * t + 2.4 * k)) for k, f in enumerate(TONES_HZ)])
    return tones.sum(axis=0), tones


def _with_unknown(trial: PreparedMotion, solution: Solution) -> PreparedMotion:
    """The trial as if a torque had acted on the output besides, the motor moving as it did: where the torque is that of
    the inertia, the twist gives way by what spring, damping and inertia let it."""
    motion, inertia = trial.motion, loop_inertia(trial)
    torque, tones = _unknown(trial)
    if not inertia:
        moved = replace(motion, torque_Nm=motion.torque_Nm + torque.imag)
        return replace(trial, motion=moved, target=trial.target + trial.project(torque.imag[:, None])[:, 0])
    omega = 2 * math.pi * np.array(TONES_HZ)[:, None]
    stiffness, damping = solution.amplitude(*STIFFNESS), solution.amplitude(*DAMPING, 0.0)
    give = -tones / (stiffness - inertia * omega**2 + 1j * omega * damping)
    twist, rate, acceleration = ((give * (1j * omega) ** k).sum(axis=0).imag for k in range(3))
    moved = replace(
        motion,
        theta_out_rad=motion.theta_out_rad - twist,
        twist_rad=motion.twist_rad + twist,
        twist_rate_rad_s=motion.twist_rate_rad_s + rate,
        velocity_out_rad_s=motion.velocity_out_rad_s - rate,
        acceleration_out_rad_s2=motion.acceleration_out_rad_s2 - acceleration,
        torque_Nm=motion.torque_Nm - inertia * acceleration,
    )
    target = trial.target - inertia * trial.project(acceleration[:, None])[:, 0]
    return replace(trial, motion=moved, target=target)

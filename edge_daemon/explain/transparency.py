"""How much of a torque that a model does not know would show in what it leaves.

A law in the loop sees a simulated twist that is held near the measured one. One that is steep there (a sign as wide as
the motion, a loop that never slips) can take up any torque and leaves little of it: its small residual says nothing.
So an unknown torque is added to the recording, and what of it is left tells how far the residual can be believed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edge_daemon.estimate.balance import Trial
from edge_daemon.estimate.settle import Loop, loop_inertia
from edge_daemon.estimate.workbench import Solution, Workbench
from edge_daemon.records import Array

SHARE = 0.02
"""of the torque's rms: enough above rounding, too little to change what sticks and what slips"""
TONES_HZ = (1.1, 2.3, 4.7, 8.9, 14.3, 23.0)
"""of the added torque: where motion and residuals are, below the torsional resonance"""


def transparency(bench: Workbench, solution: Solution) -> float:
    """rms of the change of the residual over that of a torque added to the recording of `bench`: 1 where all of it
    shows, 0 where the model takes it up."""
    added = [_unknown(trial) for trial in bench.trials]
    other = Workbench([_with(trial, torque) for trial, torque in zip(bench.trials, added, strict=True)])
    other.tied = dict(bench.tied)
    before = bench.target - _modelled(bench, solution)
    after = other.target - _modelled(other, solution)
    size = float(np.mean((other.target - bench.target) ** 2))
    return math.sqrt(float(np.mean((after - before) ** 2)) / size)


def _modelled(bench: Workbench, solution: Solution) -> Array:
    loop = Loop(bench, solution)
    return loop.modelled(loop.point, derive=False)[0]


def _unknown(trial: Trial) -> Array:
    """(n,) torque [N m] at the full rate."""
    t = trial.motion.time_s - trial.motion.time_s[0]
    tones = [np.sin(2 * math.pi * f * t + 2.4 * k) for k, f in enumerate(TONES_HZ)]
    size = SHARE * math.sqrt(float(np.mean(trial.target**2)) / (len(TONES_HZ) / 2))
    torque: Array = size * np.sum(tones, axis=0)
    return torque


def _with(trial: Trial, torque: Array) -> Trial:
    """The trial as if the torque acted on the output too: it accelerates the output, or the sensor reads it."""
    motion, inertia = trial.motion, loop_inertia(trial)
    speed = motion.velocity_out_rad_s
    if inertia:
        speed = speed + np.cumsum(torque - torque.mean()) / (inertia * motion.rate_hz)
    moved = replace(motion, velocity_out_rad_s=speed, torque_Nm=motion.torque_Nm + torque)
    return replace(trial, motion=moved, target=trial.target + trial.project(torque[:, None])[:, 0])

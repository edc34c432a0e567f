"""Joints with one encoder that several tests begin with, and what is named of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfilt

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.records import Array
from tests.explain.simulated_drives import PLAIN_SENSING, RATIO, STEP_S, Arm, Joint, record

KNOWN = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
PLAIN = Arm(weight_Nm=12.0)
RIPPLE = replace(PLAIN, waves=(("in", 2.0, 0.3, 0.4),))
RIPPLE_NAME = "wave_generator_ripple"
MESH = replace(PLAIN, mesh=0.07)


def model(*more: str) -> Model:
    return Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in (*KNOWN, *more)))


def low_passed(recording: Joint, share: float) -> Joint:
    """The same with a current whose noise ends at 25 Hz, below every band that is quiet."""
    rng, torque = np.random.default_rng(8), recording.columns["torque_in_Nm"]
    noise = sosfilt(butter(2, 25.0, fs=500.0, output="sos"), rng.normal(size=len(torque)))
    heard = torque + share * torque.std() * noise / noise.std()
    return Joint(recording.time_s, recording.columns | {"torque_in_Nm": heard})


def first_named(arm: Arm, seed: int, *known: str) -> str:
    """What comes first of what a model of `known` effects lacks."""
    found = diagnose([record(arm, seed, 20.0)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, known))))
    return found.candidates[0].effect if found.verdict == "missing" else found.verdict


def stairs(seconds: float, rng: np.random.Generator, pace: float = 1.0) -> tuple[Array, Array, Array]:
    """Constant speeds, one after the other, there and back."""
    levels = np.repeat((0.05, 0.1, 0.2, 0.35, 0.5, 0.8, 1.1), 2) * np.tile((1, -1), 7)
    t = np.arange(round(seconds / STEP_S)) * STEP_S
    smooth = np.ones(1000) / 1000
    speed = np.convolve(levels[(t / 1.6).astype(int) % 14] * np.minimum(1.0, t / 0.4), smooth, mode="same")
    return np.cumsum(speed) * STEP_S, speed, np.gradient(speed, STEP_S)


def named_in_steps(recording: Joint, *known: str) -> set[str]:
    """What diagnosis adds to a model, step by step."""
    now = Model("drive", RATIO, math.nan, tuple(map(ModelEffect, known)))
    for _ in range(6):
        found = diagnose([recording], now)
        if found.verdict != "missing":
            break
        now = add_effect(now, found.candidates[0].effect, [recording]).model
    return {row.name for row in now.effects} - set(known)


def carried(read: Joint, arm: Arm) -> tuple[Array, Array]:
    """Speed, and what passes the gear, by the smoothed motion; nought at the ends, where that is unknown."""
    angle, rate_hz = read.columns["theta_out_rad"], PLAIN_SENSING.rate_hz
    even = np.convolve(angle, np.hanning(31) / np.hanning(31).sum(), mode="same")
    speed = np.gradient(even) * rate_hz
    load = arm.weight_Nm * np.sin(angle) + (1 - arm.rotor) * arm.inertia_kg_m2 * np.gradient(speed) * rate_hz
    load[[*range(40), *range(-40, 0)]] = 0.0
    return speed, load

"""Gears and sensors with a fault, hour by hour, and the sound of their bearings: truth for `bench_faults`.

What a fault does is written from what happens in the metal, each size and gear drawn anew; nothing is imported from the
package's table, and some of the faults are not in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator
from simulated_gears import Array, coloured

HOURS, BEGINS_H, GROWS_H = 1500, 700, 300
SIZES = {"slight": 0.6, "plain": 1.5, "grave": 3.5}
SCATTER = {"stiffness": 0.006, "damping": 0.06, "coulomb_friction": 0.06, "hysteresis_area": 0.06}
SCATTER |= {"kinematic_error": 0.03, "ratio": 1e-6, **{f"noise_a{beta}": 0.12 for beta in range(5)}}

Moves = dict[str, float]
"""Condition -> change of its logarithm (kelvins for the temperature) of a fault of size 1."""


def _sounds(rng: Generator, *levels: float) -> Moves:
    return {f"noise_a{beta}": level * rng.lognormal(0.0, 0.2) for beta, level in enumerate(levels)}


def _crack(rng: Generator) -> Moves:
    return {
        "stiffness": -0.025,
        "kinematic_error": 0.04,
        "hysteresis_area": 0.03,
        **_sounds(rng, 0.02, 0.05, 0.05, 0.02, 0),
    }


def _pitted(rng: Generator) -> Moves:
    warm = 1.0 * rng.lognormal(0.0, 0.4)
    return {
        "temperature_rise": warm,
        "coulomb_friction": 0.03,
        "damping": 0.02,
        **_sounds(rng, 0.6, 0.45, 0.12, 0.03, 0),
    }


def _worn_teeth(rng: Generator) -> Moves:
    return {
        "kinematic_error": 0.16,
        "hysteresis_area": 0.18,
        "stiffness": -0.008,
        **_sounds(rng, 0.1, 0.22, 0.08, 0, 0),
    }


def _starved(rng: Generator) -> Moves:
    warm = 5.0 * rng.lognormal(0.0, 0.2)
    return {
        "coulomb_friction": 0.3,
        "temperature_rise": warm,
        "hysteresis_area": 0.12,
        **_sounds(rng, 0.35, 0.2, 0.05, 0, 0),
    }


def _aged(rng: Generator) -> Moves:
    warm = 5.0 * rng.lognormal(0.0, 0.2)
    return {"coulomb_friction": 0.28, "damping": 0.25, "temperature_rise": warm, "hysteresis_area": 0.1}


def _askew(rng: Generator) -> Moves:
    return {"kinematic_error": 0.25, "coulomb_friction": 0.09, **_sounds(rng, 0.02, 0.08, 0.3, 0.25, 0.05)}


def _loose(rng: Generator) -> Moves:
    return {"stiffness": -0.03, "damping": 0.3, "hysteresis_area": 0.35, **_sounds(rng, 0, 0.03, 0.1, 0.3, 0.5)}


def _torque_gain(rng: Generator) -> Moves:
    gain = 0.03 * rng.choice((-1.0, 1.0))
    return dict.fromkeys(("stiffness", "damping", "coulomb_friction", "hysteresis_area"), gain)


def _sound_gain(rng: Generator) -> Moves:
    return dict.fromkeys([f"noise_a{beta}" for beta in range(5)], 0.4 * rng.choice((-1.0, 1.0)))


def _thermometer(rng: Generator) -> Moves:
    return {"temperature_rise": 6.0 * rng.choice((-1.0, 1.0))}


def _disc(rng: Generator) -> Moves:
    return {"kinematic_error": 0.2}


def _wrong_oil(rng: Generator) -> Moves:
    return {"damping": -0.3, "coulomb_friction": -0.25, "temperature_rise": -3.0, "noise_a0": 0.2}


def _jammed(rng: Generator) -> Moves:
    return {"stiffness": 0.03, "noise_a4": 0.5, "hysteresis_area": -0.2}


def _foreign_sound(rng: Generator) -> Moves:
    return {"noise_a3": -0.3, "noise_a0": 0.6, "noise_a4": 0.5}


SICK = {
    "crack": ("flexspline fatigue", _crack),
    "pit, outer ring": ("bearing wear", _pitted),
    "pit, inner ring": ("bearing wear", _pitted),
    "worn teeth": ("tooth wear", _worn_teeth),
    "starved": ("lubricant", _starved),
    "aged grease": ("lubricant", _aged),
    "askew": ("misalignment", _askew),
    "loose": ("loose mounting", _loose),
    "torque gain": ("sensor", _torque_gain),
    "sound gain": ("sensor", _sound_gain),
    "thermometer": ("sensor", _thermometer),
    "encoder disc": ("sensor", _disc),
    "wrong oil": ("unknown", _wrong_oil),
    "jammed": ("unknown", _jammed),
    "foreign sound": ("unknown", _foreign_sound),
}
"""Fault -> what a technician calls it, and what it does."""


def months(rng: Generator, fault: str = "", size: float = 1.0, hours: int = HOURS) -> dict[str, Array]:
    """Hourly estimates by name; a fault begins at `BEGINS_H`."""
    h = np.arange(hours, dtype=float)
    busy = np.where((h % 24 > 6) & (h % 24 < 22), 1.0, 0.5)
    load = rng.uniform(0.4, 0.9) * busy * np.exp(coloured(rng, hours, 0.1, 8.0))
    speed = rng.uniform(0.4, 0.9) * (0.6 + 0.4 * busy) * np.exp(coloured(rng, hours, 0.1, 8.0))
    ambient = 21 + 5 * np.sin(2 * np.pi * h / 8766 + rng.uniform(0, 6.28)) + 3 * np.sin(2 * np.pi * (h - 9) / 24)
    ambient += coloured(rng, hours, 2.0, 72.0)
    moves = SICK[fault][1](rng) if fault else {}
    grown = size * np.clip((h - BEGINS_H) / GROWS_H, 0.0, 1.0)
    rise = 14 * load**0.8 * speed + moves.get("temperature_rise", 0.0) * grown + coloured(rng, hours, 0.5, 30.0)
    heat = ambient + 14 * load**0.8 * speed
    thick = np.exp(-0.018 * (heat - 25))
    clean = {
        "stiffness": 1.6e4 * (1 + 0.03 * np.tanh(3 * load)) * (1 - 3e-4 * (heat - 25)),
        "damping": 12.0 * thick,
        "coulomb_friction": 1.5 * (0.7 + 0.3 * thick) * (1 + 0.1 * load),
        "hysteresis_area": 0.02 * (1 + 0.1 * load),
        "kinematic_error": np.full(hours, 2.9e-4),
        "ratio": np.full(hours, 100.0),
        **{f"noise_a{beta}": 1e-4 * speed ** (1.5 - 0.2 * beta) * np.exp(0.006 * (heat - 25)) for beta in range(5)},
    }
    told = {}
    for name, level in clean.items():
        sd = SCATTER[name]
        stray = coloured(rng, hours, 0.4 * sd, 40.0) + sd * rng.normal(size=hours)
        told[name] = level * np.exp(moves.get(name, 0.0) * rng.lognormal(0.0, 0.2) * grown + stray)
    told |= {"temperature": ambient + rise, "temperature_rise": rise}
    return told | {"torque_rms": 52.0 * load, "speed_in": speed * 2000 * math.pi / 30}


BALLS, BALL_MM, PITCH_MM, RATIO, RATE_HZ = 23, 4.0, 40.0, 100.0, 8000.0


def heard(rng: Generator, fault: str, size: float) -> tuple[Array, Array]:
    """Angle of the wave generator [rad] and sound, some seconds of them: a blow for each ball that passes a pit."""
    time_s = np.arange(0.0, 14.0, 1.0 / RATE_HZ)
    turn = rng.uniform(9.0, 13.0) * time_s + 0.15 * np.sin(2 * math.pi * 0.1 * time_s)
    inner, outer = PITCH_MM - BALL_MM, PITCH_MM + BALL_MM
    cage = (inner - outer / RATIO) / (inner + outer)
    passes = {"pit, outer ring": cage + 1.0 / RATIO, "pit, inner ring": 1.0 - cage}.get(fault, 0.0) * BALLS
    count = np.floor(passes * turn * (1.0 + 1e-3 * rng.normal()) + rng.uniform())
    struck = np.diff(count, prepend=count[0]) > 0
    k = np.arange(80)
    ring = np.exp(-k / 12.0) * np.sin(2.0 * math.pi * rng.uniform(2000.0, 3000.0) * k / RATE_HZ)
    whirl = 0.3 * np.sin(2.0 * math.pi * turn * (1.0 if fault == "askew" else 0.0)) * size
    return turn * 2 * math.pi, 0.9 * size * np.convolve(struck, ring)[: time_s.size] + whirl + rng.normal(
        size=time_s.size
    )

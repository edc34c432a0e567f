"""A year in the life of a drive's conditions, hour by hour, healthy or with a seeded fault: truth for `bench_life`.

Conditions depend on temperature, load and speed by laws that the product's linear baseline does not have: viscosity
follows an exponential, noise a power of speed, stiffness a knee. Nothing here is imported from the package.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator
from simulated_gears import Array, coloured

FAULTS = ("flexspline fatigue", "bearing wear", "lubricant", "misalignment", "loose mounting", "ratcheting")
START_H = 2000.0
RAMP_H = {
    "flexspline fatigue": 1500.0,
    "bearing wear": 800.0,
    "lubricant": 600.0,
    "misalignment": 1.0,
    "loose mounting": 1.0,
    "ratcheting": 1.0,
}
"""how long the fault takes to grow to its size"""


def year(rng: Generator, fault: str = "", size: float = 1.0, hours: int = 8766) -> dict[str, Array]:
    """Hourly estimates by name. `size` 1 is a plain fault: 3 % stiffness lost, noise doubled, friction up by half."""
    h = np.arange(hours, dtype=float)
    busy = np.where((h % 24 > 6) & (h % 24 < 22) & (h % 168 < 120), 1.0, 0.5)
    load = rng.uniform(0.4, 0.9) * busy * np.exp(coloured(rng, hours, 0.1, 8.0))
    speed = rng.uniform(0.4, 0.9) * (0.6 + 0.4 * busy) * np.exp(coloured(rng, hours, 0.1, 8.0))
    ambient = 21 + 7 * np.sin(2 * np.pi * h / 8766 + rng.uniform(0, 6.28)) + 4 * np.sin(2 * np.pi * (h - 9) / 24)
    ambient += coloured(rng, hours, 2.0, 72.0)
    grown = size * np.clip((h - START_H) / RAMP_H.get(fault, 1.0), 0.0, 1.0)
    moved = {name: share * grown for name, share in _SIGNS.get(fault, {}).items()}
    rise = 14 * load**0.8 * speed + moved.get("temperature_rise", 0.0) + coloured(rng, hours, 0.5, 30.0)
    temperature = ambient + rise
    viscosity = np.exp(-0.018 * (temperature - 25))
    clean = {
        "stiffness": 1.6e4 * (1 + 0.03 * np.tanh(3 * load)) * (1 - 3e-4 * (temperature - 25)),
        "damping": 12.0 * viscosity,
        "coulomb_friction": 1.5 * (0.7 + 0.3 * viscosity) * (1 + 0.1 * load),
        "kinematic_error": np.full(hours, 2.9e-4),
        "ratio": np.full(hours, 100.0),
    }
    for beta in range(5):
        clean[f"noise_a{beta}"] = 1e-4 * speed ** (1.5 - 0.2 * beta) * np.exp(0.006 * (temperature - 25))
    scatter = {"stiffness": 0.006, "damping": 0.05, "coulomb_friction": 0.05, "kinematic_error": 0.03, "ratio": 1e-6}
    estimates = {}
    for name, value in clean.items():
        sd = scatter.get(name, 0.12)
        noise = coloured(rng, hours, 0.4 * sd, 40.0) + sd * rng.normal(size=hours)
        estimates[name] = value * np.exp(noise + moved.get(name, 0.0))
    estimates |= {"temperature": temperature, "temperature_rise": temperature - ambient}
    estimates |= {"torque_rms": 52.0 * load, "speed_in": speed * 2000 * math.pi / 30}
    estimates["ratcheting_events"] = (h > START_H) * 1.0 if fault == "ratcheting" else np.zeros(hours)
    return estimates


_SIGNS: dict[str, dict[str, float]] = {
    "flexspline fatigue": {"stiffness": -0.03, "kinematic_error": 0.06, "noise_a1": 0.05, "noise_a2": 0.05},
    "bearing wear": {"noise_a0": 0.7, "noise_a1": 0.5, "noise_a2": 0.15, "temperature_rise": 1.0, "damping": 0.03},
    "lubricant": {"coulomb_friction": 0.4, "damping": 0.25, "temperature_rise": 6.0, "noise_a0": 0.2, "noise_a1": 0.1},
    "misalignment": {"kinematic_error": 0.4, "noise_a2": 0.4, "noise_a3": 0.4, "coulomb_friction": 0.1},
    "loose mounting": {"stiffness": -0.04, "damping": 0.5, "noise_a3": 0.4, "noise_a4": 0.7},
    "ratcheting": {"kinematic_error": 0.2},
}
"""logarithmic change of a condition when the fault has grown to size 1 (temperature in kelvin)"""

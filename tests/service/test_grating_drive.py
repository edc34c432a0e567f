"""A fibre Bragg grating as the drive's only torque sensor: stiffness, load and ledger against the simulated gear's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.records import Estimate, Readings, Status
from edge_daemon.rig.recording import simulate
from edge_daemon.service.pipeline import Pipeline
from edge_daemon.usage.gears import find_gear

GEAR = find_gear("CSG-20-100")
NM_PER_STRAIN, NM_PER_K, STRAIN_PER_NM = 1209.0, 0.01418, 4e-6
"""1.209 pm per microstrain and 14.18 pm/K at 1550 nm, as data sheets round them; strain per newton metre of a gear."""
SECONDS, FIRST_S, NOISE_NM = 24.0, 1_763_701_200.0, 1e-4


def drive(compensated: bool) -> Drive:
    """The torque is the grating's wavelength, with the warmth taken off or, as a plain signal, left in."""
    nm_per_Nm = NM_PER_STRAIN * STRAIN_PER_NM
    plain = {"scale": 1.0 / nm_per_Nm, "offset": -1550.0 / nm_per_Nm}
    grating = {"grating_nm": 1550.0, "scale": 1.0 / STRAIN_PER_NM} if compensated else plain
    rows = [
        ChannelSettings(channel="theta_in_rad", source="can", signal="in"),
        ChannelSettings(channel="theta_out_rad", source="can", signal="out"),
        ChannelSettings(
            channel="temperature_degC", source="i2c", signal="t", unit="degC", stale_after_s=1.0, maximum=90
        ),
        ChannelSettings(channel="torque_out_Nm", source="fibre", signal="peak", unit="N m", **grating),
    ]
    return Drive(name="axis", modbus_device_id=1, model="m.toml", gear=GEAR.name, channels=tuple(rows))


def followed(compensated: bool) -> tuple[dict[str, Estimate], float, float]:
    """What the drive says at the end of a warm-up, beside the stiffness and the rms torque of the simulated gear.

    The model's inertia is half as large again as the gear's: a torque by inertia and acceleration would show it.
    """
    made = simulate((), SECONDS, seed=3, temperature=(22.0, 70.0), bits_out=0)
    truth = made.truth["parameters"]
    angle, heat = made.columns["theta_out_rad"], made.columns["temperature_degC"]
    torque = truth["inertia_kg_m2"] * np.gradient(np.gradient(angle, 1e-3), 1e-3)
    rng = np.random.default_rng(1)
    wavelength = 1550.0 + NM_PER_STRAIN * STRAIN_PER_NM * torque + NM_PER_K * (heat - 25.0)
    wavelength += NOISE_NM * rng.normal(size=wavelength.size)
    parts = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    model = Model("torsion", truth["ratio"], 1.5 * truth["inertia_kg_m2"], parts)
    pipeline = Pipeline(drive(compensated), Path("m.toml"), model, GEAR)
    for part in np.array_split(np.arange(angle.size), round(SECONDS)):
        time_s = FIRST_S + made.time_s[part]
        pipeline.push(Readings("can", "in", time_s, made.columns["theta_in_rad"][part]))
        pipeline.push(Readings("can", "out", time_s, angle[part] + rng.normal(0.0, 2e-7, part.size)))
        pipeline.push(Readings("i2c", "t", time_s[::50], heat[part][::50]))
        pipeline.push(Readings("fibre", "peak", time_s, wavelength[part]))
        step = pipeline.step(time_s[-1] + 0.5, ())
    return dict(step.snapshot.estimates), truth["stiffness_Nm_per_rad"], float(np.sqrt(np.mean(torque**2)))


def test_strain_is_the_torque_of_stiffness_and_load() -> None:
    told, stiffness, rms = followed(compensated=True)
    assert told["stiffness"].status is Status.VALID
    assert told["stiffness"].value == pytest.approx(stiffness, rel=0.01)
    assert abs(told["stiffness"].value - stiffness) < 4.0 * told["stiffness"].sd + 2e-3 * stiffness
    assert told["torque_rms"].value == pytest.approx(rms, rel=0.1)
    assert told["torque_cubic_mean"].value == pytest.approx(rms, rel=0.6)


def test_warmth_left_in_the_wavelength_is_no_load() -> None:
    """41 kelvins are 0.6 nm, 120 newton metres: what the compensation keeps out of the ledger of loads."""
    told, _, rms = followed(compensated=False)
    assert told["torque_cubic_mean"].value > 5.0 * rms

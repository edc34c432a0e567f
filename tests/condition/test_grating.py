"""A fibre Bragg grating on a loaded flexspline that warms: against the strain that made its wavelength."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.condition.conditioner import Conditioner
from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.records import Array, Block, Readings

RATE_HZ, SECONDS = 500.0, 4.0
UNSTRAINED_NM, NM_PER_STRAIN, NM_PER_K = 1550.0, 1209.0, 0.01418
"""1.209 pm per microstrain and 14.18 pm/K at 1550 nm: 0.78 and 9.15e-6 of the wavelength, as data sheets round them."""
TIME_S: Array = 1000.0 + np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
STRAIN: Array = 3e-4 * np.sin(2 * np.pi * 2.0 * (TIME_S - 1000.0))
HEAT = ChannelSettings(channel="temperature_degC", source="i2c", signal="t", unit="degC", stale_after_s=1.0, maximum=90)


def heat_at(time_s: Array) -> Array:
    return 35.0 + 2.0 * (time_s - 1000.0)


def blocks_of(row: ChannelSettings, heat_degC: Array, heat_s: Array) -> list[Block]:
    """What a drive makes of the grating's wavelength, whose truth is written in picometres and not in the formula."""
    wavelength = UNSTRAINED_NM + NM_PER_STRAIN * STRAIN + NM_PER_K * (heat_at(TIME_S) - 25.0)
    drive = Drive(name="axis", modbus_device_id=1, model="axis.toml", channels=(HEAT, row), rate_hz=RATE_HZ)
    conditioner = Conditioner(drive)
    conditioner.push(Readings("i2c", "t", heat_s, heat_degC))
    conditioner.push(Readings("fibre", "peak", TIME_S, wavelength))
    return conditioner.blocks(np.inf)


@pytest.mark.parametrize(("channel", "scale", "unit", "size"), [
    ("strain_flexspline", 1.0, "1", 1.0), ("torque_out_Nm", 2.5e8, "mN m", 2.5e5),
])  # fmt: skip
def test_strain_or_torque_without_the_warmth(channel: str, scale: float, unit: str, size: float) -> None:
    row = ChannelSettings(channel=channel, source="fibre", signal="peak", grating_nm=1550.0, scale=scale, unit=unit)
    heat_s = TIME_S[::50]
    found = blocks_of(row, heat_at(heat_s), heat_s)
    told = np.concatenate([block.values[channel] for block in found]) / size
    good = np.concatenate([block.valid(channel) for block in found])
    truth = STRAIN[: len(told)]
    assert good.sum() > 0.9 * len(STRAIN)
    off = (told - truth)[good]
    # data sheets round the sensitivities to 0.1 %; the thermometer answers every 0.1 s: 0.2 K
    assert np.max(np.abs(off)) < 0.2 * NM_PER_K / NM_PER_STRAIN + 2e-3 * np.max(np.abs(truth))
    assert np.max(np.abs(off)) < 0.01 * (NM_PER_K / NM_PER_STRAIN * 18.0 / 0.4), "the warmth left in is forty times it"


def test_without_a_usable_temperature_there_is_no_strain() -> None:
    row = ChannelSettings(channel="strain_flexspline", source="fibre", signal="peak", grating_nm=1550.0)
    heat_s = TIME_S[::50]
    found = blocks_of(row, np.where(heat_s < TIME_S[len(TIME_S) // 2], heat_at(heat_s), 200.0), heat_s)
    good = np.concatenate([block.valid("strain_flexspline") for block in found])
    half = len(good) // 2
    assert good[100 : half - 100].all() and not good[half + 100 :].any()

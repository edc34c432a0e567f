"""The Modbus sensor, read by a client over loopback."""

from __future__ import annotations

import struct
from collections.abc import AsyncIterator

import numpy as np
import pytest
from pymodbus.client import AsyncModbusTcpClient

from edge_daemon.rig.live import LiveDrive, live_drive
from edge_daemon.rig.modbus_face import ADDRESS_BANDS, ADDRESS_WAVEFORM, BAND_AVERAGES, BANDS, ModbusFace

Served = tuple[ModbusFace, AsyncModbusTcpClient, LiveDrive]


@pytest.fixture
async def served() -> AsyncIterator[Served]:
    drive = live_drive(seed=3)
    face = ModbusFace({1: drive, 2: live_drive(seed=4)})
    client = AsyncModbusTcpClient("127.0.0.1", port=await face.start(), timeout=1.0, retries=0)
    assert await client.connect()
    yield face, client, drive
    client.close()
    await face.stop()


async def registers(client: AsyncModbusTcpClient, address: int, count: int, device: int = 1) -> list[int]:
    return (await client.read_input_registers(address, count=count, device_id=device)).registers


def floats(words: list[int]) -> np.ndarray:
    return np.frombuffer(struct.pack(f">{len(words)}H", *words), ">f4").astype(float)


async def test_temperature_and_pressure_in_both_forms(served: Served) -> None:
    _, client, drive = served
    drive.housing.temperature_degC = 41.5
    words = await registers(client, 0, 14)
    assert words[0] / 100 == pytest.approx(41.5, abs=0.1)
    assert words[1] * 10 == pytest.approx(drive.housing.pressure_Pa, abs=20.0)
    assert floats(words[10:14]) == pytest.approx([41.5, drive.housing.pressure_Pa], abs=20.0)
    holding = await client.read_holding_registers(0, count=1, device_id=1)
    assert holding.registers[0] / 100 == pytest.approx(41.5, abs=0.1)


async def test_a_temperature_below_zero_is_twos_complement(served: Served) -> None:
    _, client, drive = served
    drive.housing.temperature_degC = -12.0
    assert (await registers(client, 0, 1))[0] - 65_536 == pytest.approx(-1200, abs=10)


async def test_band_levels_are_pairs_around_the_spectrum(served: Served) -> None:
    _, client, drive = served
    words = [*(await registers(client, ADDRESS_BANDS, 120)), *(await registers(client, ADDRESS_BANDS + 120, 120))]
    words += await registers(client, ADDRESS_BANDS + 240, 4 * BANDS - 240)
    pairs = floats(words).reshape(BANDS, 2)
    assert pairs[0, 0] == pytest.approx(10.0)
    assert pairs[-1, 0] == pytest.approx(10_000.0)
    ratio = pairs[:, 1] / drive.microphone.psd(pairs[:, 0])
    assert np.abs(ratio - 1).max() < 5 / np.sqrt(BAND_AVERAGES)


async def test_a_waveform_stays_the_same_until_its_first_register_is_read_again(served: Served) -> None:
    _, client, _ = served
    first = await registers(client, ADDRESS_WAVEFORM, 100)
    later = await registers(client, ADDRESS_WAVEFORM + 50, 50)
    assert later == first[50:]
    assert await registers(client, ADDRESS_WAVEFORM, 100) != first


async def test_each_drive_has_its_device_and_a_missing_one_is_refused(served: Served) -> None:
    face, client, _ = served
    face.sensors[2].drive.housing.temperature_degC = 77.0
    assert (await registers(client, 0, 1, device=2))[0] / 100 == pytest.approx(77.0, abs=0.1)


async def test_faults(served: Served) -> None:
    face, client, _ = served
    face.sensors[1].fault = "exception"
    assert (await client.read_input_registers(0, count=2, device_id=1)).isError()
    face.sensors[1].fault = "garbage"
    assert await registers(client, 0, 2) == [0xFFFF, 0xFFFF]
    face.sensors[1].fault = "none"
    assert (await registers(client, 0, 1))[0] != 0xFFFF

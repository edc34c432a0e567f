"""The I2C devices, read as a driver reads them, in the process and over the socket."""

from __future__ import annotations

import asyncio
import errno
import struct
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.rig import bmp280
from edge_daemon.rig.i2c_face import (
    BURST_ADDRESS,
    PASCAL_PER_COUNT,
    REGISTER_CONTROL,
    REGISTER_DATA,
    REGISTER_STATUS,
    BurstSensor,
    RegisterBus,
    open_bus,
    serve,
)

DATASHEET_RAW_T, DATASHEET_RAW_P = 519_888, 415_148
"""worked example of BST-BMP280-DS001, section 3.12: 25.08 degC, 100 653.27 Pa"""


def compensated(data: bytes, calibration: bytes) -> tuple[float, float]:
    """degC and Pa by the datasheet's integer formulas (section 3.11.3), which the rig does not use."""
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9 = struct.unpack("<HhhHhhhhhhhh", calibration)
    raw_p, raw_t = (int.from_bytes(data[i : i + 3], "big") >> 4 for i in (0, 3))
    var1 = (((raw_t >> 3) - (t1 << 1)) * t2) >> 11
    var2 = (((((raw_t >> 4) - t1) * ((raw_t >> 4) - t1)) >> 12) * t3) >> 14
    fine = var1 + var2
    temperature = ((fine * 5 + 128) >> 8) / 100
    var1 = fine - 128_000
    var2 = var1 * var1 * p6 + ((var1 * p5) << 17) + (p4 << 35)
    var1 = ((var1 * var1 * p3) >> 8) + ((var1 * p2) << 12)
    var1 = (((1 << 47) + var1) * p1) >> 33
    p = (((1_048_576 - raw_p) << 31) - var2) * 3125 // var1
    p = ((p + ((p9 * (p >> 13) * (p >> 13)) >> 25) + ((p8 * p) >> 19)) >> 8) + (p7 << 4)
    return temperature, p / 256


def test_the_datasheets_worked_example() -> None:
    c = bmp280.DATASHEET_CALIBRATION
    fine = bmp280.temperature_fine(DATASHEET_RAW_T, c)
    assert fine / 5120 == pytest.approx(25.08, abs=0.005)
    assert bmp280.pressure_Pa(DATASHEET_RAW_P, fine, c) == pytest.approx(100_653.27, abs=0.3)


@pytest.mark.parametrize(("degC", "pascal"), [(25.08, 100_653.0), (-20.0, 80_000.0), (70.0, 109_000.0)])
def test_the_raw_registers_turn_back_into_the_truth(degC: float, pascal: float) -> None:
    bus = RegisterBus({bmp280.ADDRESS: bmp280.Bmp280(lambda: (degC, pascal))})
    assert bus.read_byte_data(bmp280.ADDRESS, 0xD0) == 0x58
    bus.write_byte_data(bmp280.ADDRESS, 0xF4, 0x27)
    calibration = bytes(bus.read_i2c_block_data(bmp280.ADDRESS, 0x88, 24))
    temperature, pressure = compensated(bytes(bus.read_i2c_block_data(bmp280.ADDRESS, 0xF7, 6)), calibration)
    assert temperature == pytest.approx(degC, abs=0.02)
    assert pressure == pytest.approx(pascal, abs=3.0)


def test_asleep_it_shows_no_measurement_and_forced_mode_measures_once() -> None:
    readings = iter([(20.0, 1e5), (30.0, 1e5), (40.0, 1e5)])
    part = bmp280.Bmp280(lambda: next(readings))
    assert part.read(0xF7, 6) == bytes((0x80, 0, 0, 0x80, 0, 0))
    part.write(0xF4, b"\x25")
    first = part.read(0xF7, 6)
    assert first != bytes((0x80, 0, 0, 0x80, 0, 0))
    assert part.read(0xF7, 6) == first


def ramp(samples: int, rate_hz: float) -> np.ndarray:
    return np.arange(samples) * PASCAL_PER_COUNT


def test_a_burst_is_ready_when_it_has_passed_and_reads_out_in_pieces() -> None:
    now = [0.0]
    bus = RegisterBus({BURST_ADDRESS: BurstSensor(ramp, lambda: now[0], samples=100, rate_hz=1000.0)})
    assert bus.read_byte_data(BURST_ADDRESS, REGISTER_STATUS) == 0
    bus.write_byte_data(BURST_ADDRESS, REGISTER_CONTROL, 1)
    assert bus.read_byte_data(BURST_ADDRESS, REGISTER_STATUS) == 0
    now[0] = 0.101
    assert bus.read_byte_data(BURST_ADDRESS, REGISTER_STATUS) == 1
    data = b"".join(bytes(bus.read_i2c_block_data(BURST_ADDRESS, REGISTER_DATA, 32)) for _ in range(7))
    np.testing.assert_array_equal(np.frombuffer(data[:200], "<i2"), np.arange(100))
    assert data[200:] == bytes(24)


def test_faults_are_those_of_a_real_bus() -> None:
    bus = RegisterBus({bmp280.ADDRESS: bmp280.Bmp280(lambda: (20.0, 1e5))})
    with pytest.raises(OSError, match="Remote I/O") as missing:
        bus.read_byte_data(0x11, 0)
    assert missing.value.errno == errno.EREMOTEIO
    bus.fault = "short"
    assert len(bus.read_i2c_block_data(bmp280.ADDRESS, 0x88, 24)) == 12
    bus.fault = "garbage"
    assert bus.read_i2c_block_data(bmp280.ADDRESS, 0x88, 3) == [0xFF] * 3
    bus.fault = "none"
    bus.read_i2c_block_data(bmp280.ADDRESS, 0xD0, 1)
    bus.fault = "previous"
    assert bus.read_i2c_block_data(bmp280.ADDRESS, 0x88, 2) == [0x58, 0]
    bus.fault = "absent"
    with pytest.raises(OSError, match="Remote I/O"):
        bus.write_byte_data(bmp280.ADDRESS, 0xF4, 0)


async def test_the_socket_carries_the_same_calls(tmp_path: Path) -> None:
    bus = RegisterBus({bmp280.ADDRESS: bmp280.Bmp280(lambda: (20.0, 1e5))})
    server = await serve(bus, tmp_path / "i2c")

    def talk() -> tuple[int, list[int], int | None]:
        client = open_bus(f"sim:{tmp_path / 'i2c'}")
        try:
            client.write_byte_data(bmp280.ADDRESS, 0xF4, 0x27)
            code = None
            try:
                client.read_byte_data(0x11, 0)
            except OSError as error:
                code = error.errno
            block = client.read_i2c_block_data(bmp280.ADDRESS, 0x88, 24)
            return client.read_byte_data(bmp280.ADDRESS, 0xF4), block, code
        finally:
            client.close()

    control, block, code = await asyncio.wait_for(asyncio.to_thread(talk), 5.0)
    server.close()
    assert control == 0x27
    assert bytes(block) == struct.pack("<HhhHhhhhhhhh", *bmp280.DATASHEET_CALIBRATION)
    assert code == errno.EREMOTEIO


def test_a_socket_nobody_serves_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        open_bus(f"sim:{tmp_path / 'nobody'}")

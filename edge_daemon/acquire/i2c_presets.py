"""Pressure and temperature parts whose arithmetic is known: one row each."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from edge_daemon.acquire.i2c_transfer import DeviceError, Registers


@dataclass(frozen=True, slots=True)
class Preset:
    """A part: how to start it, how to read it."""

    name: str
    meaning: str
    source: str
    addresses: tuple[int, ...]
    """that its pins can be set to"""
    signals: Mapping[str, str]
    """name -> unit"""
    prepare: Callable[[Registers], Any]
    """starts the measurement; returns the calibration that `read` needs"""
    read: Callable[[Registers, Any], dict[str, float]]
    """signal -> value, NaN where the part has not measured yet"""
    first_after_s: float
    """from being started to the first measurement"""


def _expect(registers: Registers, register: int, identity: int, part: str) -> None:
    found = registers.read(register, 1)[0]
    if found != identity:
        raise DeviceError(f"is no {part}: its identity is 0x{found:02X}, expected 0x{identity:02X}")


BMP280_CALIBRATION = struct.Struct("<HhhHhhhhhhhh")
BMP280_FILTER_16_EVERY_MS = 0x10
"""Register config: standby 0.5 ms, infinite impulse response filter 16 (tables 6 and 11)."""
BMP280_RUN = 0x57
"""Register ctrl_meas: temperature twice, pressure sixteen times oversampled, normal mode (tables 4, 5 and 10)."""
BMP280_SKIPPED = 0x80000
"""A conversion that was not made has this raw value (register description of press and temp)."""


def _prepare_bmp280(registers: Registers) -> tuple[int, ...]:
    _expect(registers, 0xD0, 0x58, "BMP280")
    calibration: tuple[int, ...] = BMP280_CALIBRATION.unpack(registers.read(0x88, BMP280_CALIBRATION.size))
    if calibration[0] == 0 or calibration[3] == 0:
        raise DeviceError("has no calibration")
    registers.write(0xF5, BMP280_FILTER_16_EVERY_MS)
    registers.write(0xF4, BMP280_RUN)
    return calibration


def _read_bmp280(registers: Registers, calibration: tuple[int, ...]) -> dict[str, float]:
    data = registers.read(0xF7, 6)  # one read, so that pressure and temperature are of one measurement
    raw_pressure = int.from_bytes(data[:3], "big") >> 4
    raw_temperature = int.from_bytes(data[3:], "big") >> 4
    if BMP280_SKIPPED in (raw_pressure, raw_temperature):
        return {"pressure": math.nan, "temperature": math.nan}
    fine = bmp280_fine(raw_temperature, calibration)
    return {"pressure": bmp280_pressure_Pa(raw_pressure, fine, calibration), "temperature": fine / 5120.0}


def bmp280_fine(raw: int, calibration: tuple[int, ...]) -> float:
    """Temperature in 1/5120 degC from its 20-bit raw value. Datasheet BST-BMP280-DS001-23, section 8.1, page 44."""
    t1, t2, t3 = calibration[:3]
    return (raw / 16384.0 - t1 / 1024.0) * t2 + (raw / 131072.0 - t1 / 8192.0) ** 2 * t3


def bmp280_pressure_Pa(raw: int, fine: float, calibration: tuple[int, ...]) -> float:
    """Pressure from its 20-bit raw value. Datasheet BST-BMP280-DS001-23, section 8.1, page 44 and 45."""
    p1, p2, p3, p4, p5, p6, p7, p8, p9 = calibration[3:]
    warm = fine / 2.0 - 64000.0
    offset = (warm * warm * p6 / 32768.0 + warm * p5 * 2.0) / 4.0 + p4 * 65536.0
    sensitivity = (1.0 + (p3 * warm * warm / 524288.0 + p2 * warm) / 524288.0 / 32768.0) * p1
    linear = (1048576.0 - raw - offset / 4096.0) * 6250.0 / sensitivity
    return linear + (p9 * linear * linear / 2147483648.0 + linear * p8 / 32768.0 + p7) / 16.0


LPS22HB_RUN = 0x22
"""CTRL_REG1: ten measurements a second, no update between the bytes of one (BDU)"""
LPS22HB_COUNTS_PER_PA = 40.96
LPS22HB_COUNTS_PER_K = 100.0


def _prepare_lps22hb(registers: Registers) -> None:
    _expect(registers, 0x0F, 0xB1, "LPS22HB")
    registers.write(0x10, LPS22HB_RUN)


def _read_lps22hb(registers: Registers, _calibration: None) -> dict[str, float]:
    data = registers.read(0x28, 5)
    if not any(data):  # as after power-up, before the first measurement
        return {"pressure": math.nan, "temperature": math.nan}
    return {
        "pressure": int.from_bytes(data[:3], "little", signed=True) / LPS22HB_COUNTS_PER_PA,
        "temperature": int.from_bytes(data[3:], "little", signed=True) / LPS22HB_COUNTS_PER_K,
    }


TMP117_KELVIN_PER_COUNT = 0.0078125
TMP117_NEVER_MEASURED = 0x8000
"""Raw temperature after power-up, before the first conversion: -256 degC (register description)."""


def _prepare_tmp117(registers: Registers) -> None:
    _expect(registers, 0x0F, 0x01, "TMP117")  # the high byte of the device id; the part measures by itself


def _read_tmp117(registers: Registers, _calibration: None) -> dict[str, float]:
    raw = registers.read(0x00, 2)
    if int.from_bytes(raw, "big") == TMP117_NEVER_MEASURED:
        return {"temperature": math.nan}
    return {"temperature": int.from_bytes(raw, "big", signed=True) * TMP117_KELVIN_PER_COUNT}


MCP9808_SIGN, MCP9808_COUNTS_PER_K = 0x1000, 16.0
"""The ambient temperature is three flags, this bit below zero, and twelve bits of sixteenths (register 5-4)."""


def _prepare_mcp9808(registers: Registers) -> None:
    _expect(registers, 0x07, 0x04, "MCP9808")  # the part measures by itself


def _read_mcp9808(registers: Registers, _calibration: None) -> dict[str, float]:
    word = int.from_bytes(registers.read(0x05, 2), "big")
    counts = word % MCP9808_SIGN - (MCP9808_SIGN if word & MCP9808_SIGN else 0)
    return {"temperature": counts / MCP9808_COUNTS_PER_K}


PRESETS: dict[str, Preset] = {
    row.name: row
    for row in (
        Preset(
            "bmp280",
            "Bosch BMP280, 300 to 1100 hPa",
            "BST-BMP280-DS001-23: memory map page 24, calibration words table 17 page 21, formulas page 44",
            (0x76, 0x77),
            {"pressure": "Pa", "temperature": "degC"},
            _prepare_bmp280,
            _read_bmp280,
            first_after_s=0.05,  # 43.2 ms at most with this oversampling (table 13)
        ),
        Preset(
            "lps22hb",
            "ST LPS22HB, 260 to 1260 hPa",
            "DocID027083 Rev 6: register map and description; 4096 counts per hPa, 100 counts per degC",
            (0x5C, 0x5D),
            {"pressure": "Pa", "temperature": "degC"},
            _prepare_lps22hb,
            _read_lps22hb,
            first_after_s=0.1,  # ten measurements a second
        ),
        Preset(
            "tmp117",
            "TI TMP117, -55 to 150 degC",
            "SBOS740: register map; 1/128 K per count, device id 0x0117, eight averages after power-up",
            (0x48, 0x49, 0x4A, 0x4B),
            {"temperature": "degC"},
            _prepare_tmp117,
            _read_tmp117,
            first_after_s=0.15,  # eight averages of 15.5 ms each
        ),
        Preset(
            "mcp9808",
            "Microchip MCP9808, -40 to 125 degC",
            "DS25095A: register 5-4 and equation 5-1, 1/16 K per count; device id 0x04 in register 5-6",
            (0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x1E, 0x1F),
            {"temperature": "degC"},
            _prepare_mcp9808,
            _read_mcp9808,
            first_after_s=0.3,  # 250 ms at the resolution it starts with
        ),
    )
}

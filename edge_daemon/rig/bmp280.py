"""A pressure and temperature part with the registers of the Bosch BMP280.

Source: Bosch Sensortec BST-BMP280-DS001, memory map (table 18), calibration words (table 17), and the compensation
formulas in double precision (section 8.1), inverted here: the part must show the raw values that a reader turns back
into the true ones.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

ADDRESS = 0x76
CHIP_ID = 0x58
REGISTER_CALIBRATION, REGISTER_ID, REGISTER_RESET = 0x88, 0xD0, 0xE0
REGISTER_STATUS, REGISTER_CONTROL, REGISTER_CONFIG, REGISTER_DATA = 0xF3, 0xF4, 0xF5, 0xF7
RESET_WORD = 0xB6
MODE_MASK = 0x03
MODE_SLEEP, MODE_NORMAL = 0x00, 0x03
RAW_BITS = 20

DATASHEET_CALIBRATION = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
"""The words dig_T1..T3 and dig_P1..P9 are those of the data sheet's worked example (section 3.12)."""
_CALIBRATION = struct.Struct("<HhhHhhhhhhhh")


def temperature_fine(raw: float, c: tuple[int, ...]) -> float:
    """t_fine, 5120 per degree."""
    x = (raw / 16384 - c[0] / 1024) * c[1]
    y = (raw / 131072 - c[0] / 8192) ** 2 * c[2]
    return x + y


def pressure_Pa(raw: float, fine: float, c: tuple[int, ...]) -> float:
    """Compensated pressure."""
    p1, p2, p3, p4, p5, p6, p7, p8, p9 = c[3:]
    x = fine / 2 - 64000
    y = x * x * p6 / 32768 + x * p5 * 2
    y = y / 4 + p4 * 65536
    x = (1 + (p3 * x * x / 524288 + p2 * x) / 524288 / 32768) * p1
    p = (1048576 - raw - y / 4096) * 6250 / x
    return p + (p9 * p * p / 2147483648 + p * p8 / 32768 + p7) / 16


def _inverted(function: Callable[[float], float], wanted: float) -> int:
    """The 20-bit raw value at which a monotone function comes nearest to `wanted`, by halving."""
    low, high = 0, (1 << RAW_BITS) - 1
    rising = function(high) > function(low)
    while high - low > 1:
        middle = (low + high) // 2
        if (function(middle) < wanted) == rising:
            low = middle
        else:
            high = middle
    return low if abs(function(low) - wanted) <= abs(function(high) - wanted) else high


@dataclass(slots=True)
class Bmp280:
    """`measure` gives the true temperature [degC] and pressure [Pa]; measured anew at each read of the data."""

    measure: Callable[[], tuple[float, float]]
    calibration: tuple[int, ...] = DATASHEET_CALIBRATION
    _control: int = MODE_SLEEP
    _config: int = 0
    _data: bytes = field(default=bytes((0x80, 0, 0, 0x80, 0, 0)))

    def read(self, register: int, length: int) -> bytes:
        """`length` bytes from `register` on, the address counting up as in the part; unknown registers read 0."""
        if register <= REGISTER_DATA < register + length and self._control & MODE_MASK != MODE_SLEEP:
            self._convert()
        return bytes(self._byte(register + i) for i in range(length))

    def write(self, register: int, data: bytes) -> None:
        """Control, configuration and reset; a write anywhere else has no effect."""
        if not data:
            return
        if register == REGISTER_CONTROL:
            self._control = data[0]
        elif register == REGISTER_CONFIG:
            self._config = data[0]
        elif register == REGISTER_RESET and data[0] == RESET_WORD:
            self._control = self._config = 0

    def _byte(self, register: int) -> int:
        calibration = _CALIBRATION.pack(*self.calibration)
        if REGISTER_CALIBRATION <= register < REGISTER_CALIBRATION + len(calibration):
            return calibration[register - REGISTER_CALIBRATION]
        if REGISTER_DATA <= register < REGISTER_DATA + len(self._data):
            return self._data[register - REGISTER_DATA]
        fixed = {REGISTER_ID: CHIP_ID, REGISTER_CONTROL: self._control, REGISTER_CONFIG: self._config}
        return fixed.get(register, 0)

    def _convert(self) -> None:
        temperature, pressure = self.measure()
        c = self.calibration
        raw_t = _inverted(lambda raw: temperature_fine(raw, c) / 5120, temperature)
        fine = temperature_fine(raw_t, c)
        raw_p = _inverted(lambda raw: pressure_Pa(raw, fine, c), pressure)
        self._data = (raw_p << 4).to_bytes(3, "big") + (raw_t << 4).to_bytes(3, "big")
        if self._control & MODE_MASK != MODE_NORMAL:
            self._control &= ~MODE_MASK  # forced mode: one measurement, then asleep again

"""What is read of one I2C device: named values, or a burst of samples. Blocking; runs in the thread of its bus."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from edge_daemon.acquire.i2c_presets import PRESETS
from edge_daemon.acquire.i2c_transfer import BLOCK, DeviceError, Registers
from edge_daemon.config.settings import I2cBurst, I2cDevice, I2cRegister
from edge_daemon.records import Array

CAPTURE = 1
"""This value in the control register starts a capture."""
READY = 1
"""This bit of the status register says that a capture is there."""
SLICE_BYTES = 512
"""So much is fetched before other devices get their turn: 50 ms on a bus of 100 kHz."""
PATIENCE = 1.0
"""A capture may take this much longer than its own length, relatively."""
PATIENCE_S = 0.1
"""A capture may take this much longer besides."""
SETTLE_S = 1.0
"""A part that was set up this long ago must have measured; if not, it lost its settings (slowest preset: 0.15 s)."""
WORD_BITS = {"u8": 8, "i8": 8, "u16": 16, "i16": 16, "u24": 24, "i24": 24, "u32": 32, "i32": 32, "f32": 32}


class RegisterDevice:
    """A part from the table of presets, or registers from the configuration."""

    def __init__(self, device: I2cDevice, registers: Registers) -> None:
        self._rows = device.registers
        self._preset = PRESETS[device.preset] if device.preset else None
        self._registers = registers
        self._calibration: Any = None
        self._prepared_s = -math.inf
        self._prepared = False
        self.signals = tuple(self._preset.signals) if self._preset else tuple(row.signal for row in self._rows)

    def read(self) -> tuple[float, dict[str, float]]:
        """When (monotonic), and each signal's value. Raises `DeviceError` if none could be read, `BusGone`."""
        before_s = time.monotonic()
        found = self._read_preset() if self._preset else self._read_rows()
        return (before_s + time.monotonic()) / 2, found

    def _read_preset(self) -> dict[str, float]:
        """A part that failed or forgot its settings (a power dip) is set up again."""
        assert self._preset is not None
        try:
            if not self._prepared:
                self._calibration = self._preset.prepare(self._registers)
                self._prepared, self._prepared_s = True, time.monotonic()
                time.sleep(self._preset.first_after_s)  # a thread of its own: only this bus waits
            found = self._preset.read(self._registers, self._calibration)
        except (DeviceError, ZeroDivisionError) as error:
            self._prepared = False
            raise DeviceError(str(error)) from error
        if any(map(math.isnan, found.values())) and time.monotonic() - self._prepared_s > SETTLE_S:
            self._prepared = False
        return found

    def _read_rows(self) -> dict[str, float]:
        found: dict[str, float] = {}
        failure: DeviceError | None = None
        for row in self._rows:
            try:
                found[row.signal] = _value(row, self._registers)
            except DeviceError as error:
                found[row.signal], failure = math.nan, error
        if failure and all(map(math.isnan, found.values())):
            raise failure
        return found


def _value(row: I2cRegister, registers: Registers) -> float:
    length = WORD_BITS[row.type] // 8
    read = {
        "none": registers.read,
        "crc8_sensirion": registers.read_sensirion,
        "smbus_pec": registers.read_pec,
    }[row.crc]
    data = read(row.register, length)
    if row.type == "f32":
        raw = float(np.frombuffer(data, ">f4" if row.byte_order == "big" else "<f4")[0])
    else:
        raw = int.from_bytes(data, row.byte_order, signed=row.type.startswith("i"))
    return raw * row.scale + row.offset


class BurstDevice:
    """An acoustic sensor that records by itself and is emptied afterwards."""

    def __init__(self, settings: I2cBurst, registers: Registers) -> None:
        self.settings = settings
        self.duration_s = settings.samples / settings.rate_hz
        self.patience_s = PATIENCE * self.duration_s + PATIENCE_S
        self.poll_s = max(0.001, self.duration_s / 100)
        self._registers = registers
        self._data = bytearray()

    def start(self) -> float:
        """Starts a capture; returns when (monotonic). Raises `DeviceError`, `BusGone`, as all here."""
        self._data.clear()
        self._registers.write(self.settings.control_register, CAPTURE)
        return time.monotonic()

    def is_ready(self) -> bool:
        """Whether the capture has ended."""
        return bool(self._registers.read_once(self.settings.status_register)[0] & READY)

    @property
    def complete(self) -> bool:
        """Whether all samples are here."""
        return len(self._data) >= 2 * self.settings.samples

    def fetch(self) -> None:
        """Some more samples."""
        end = min(len(self._data) + SLICE_BYTES, 2 * self.settings.samples)
        chunk = min(self.settings.chunk_bytes, BLOCK)
        while len(self._data) < end:
            length = min(chunk, 2 * self.settings.samples - len(self._data))
            self._data += self._registers.stream(self.settings.data_register, length)

    def values(self) -> Array:
        """(samples,) as configured: raw counts times scale."""
        order = ">i2" if self.settings.byte_order == "big" else "<i2"
        return np.frombuffer(bytes(self._data), order).astype(np.float64) * self.settings.scale

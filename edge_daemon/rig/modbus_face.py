"""The drive's sensors on Modbus TCP: one device id per drive, the same registers as input and holding registers.

| address | type | content |
|---|---|---|
| 0 | i16 | housing temperature, 0.01 degC |
| 1 | u16 | housing pressure, 10 Pa |
| 2 | i16 | air temperature, 0.01 degC |
| 3 | u16 | counts up once a second |
| 10 | f32 | housing temperature [degC] |
| 12 | f32 | housing pressure [Pa] |
| 200.. | f32 pairs | band centre [Hz], level [Pa^2/Hz]: `BANDS` pairs, word order big |
| 1000.. | i16 | sound waveform, `WAVEFORM_SAMPLES` values at 25.6 kHz, 1e-4 Pa; a read of 1000 takes a new one |
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from edge_daemon.rig.i2c_face import BURST_RATE_HZ, waveform_i16
from edge_daemon.rig.live import LiveDrive
from edge_daemon.rig.sensors import AMBIENT_DEGC, HIGH_HZ, LOW_HZ

ADDRESS_BANDS = 200
BANDS = 64
BAND_AVERAGES = 1000.0
"""So many independent averages stand behind each level: a sensor that averages over its whole band and some seconds
(chosen)."""
ADDRESS_WAVEFORM = 1000
WAVEFORM_SAMPLES = 8192
REGISTERS = ADDRESS_WAVEFORM + WAVEFORM_SAMPLES
BAND_CENTRES_HZ = np.geomspace(LOW_HZ, HIGH_HZ, BANDS)

SILENCE_S = 60.0
"""No client waits that long."""
MODBUS_FAULTS = ("none", "exception", "silent", "garbage")


@dataclass(slots=True)
class SensorRegisters:
    """What one drive's sensor answers, worked out when it is asked."""

    drive: LiveDrive
    fault: str = "none"

    def refresh(self, address: int, count: int, registers: list[int]) -> None:
        """Brings `registers` (from address 0) up to date as far as the request [address, address + count) sees."""
        end = address + count
        if address < 14:
            self._refresh_values(registers)
        if address <= ADDRESS_BANDS < end:
            levels = self.drive.bands(BAND_CENTRES_HZ, BAND_AVERAGES)
            pairs = np.column_stack((BAND_CENTRES_HZ, levels)).ravel()
            registers[ADDRESS_BANDS : ADDRESS_BANDS + 4 * BANDS] = _words(pairs.astype(">f4").tobytes())
        if address <= ADDRESS_WAVEFORM < end:
            sound = waveform_i16(self.drive.sound(WAVEFORM_SAMPLES, BURST_RATE_HZ))
            registers[ADDRESS_WAVEFORM:REGISTERS] = _words(sound.astype(">i2").tobytes())

    def _refresh_values(self, registers: list[int]) -> None:
        temperature, pressure = self.drive.housing.measured()
        registers[0] = round(temperature * 100) & 0xFFFF
        registers[1] = round(pressure / 10) & 0xFFFF
        registers[2] = round(AMBIENT_DEGC * 100)
        registers[3] = int(self.drive.time_s) & 0xFFFF
        registers[10:14] = _words(struct.pack(">ff", temperature, pressure))

    async def action(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: Any
    ) -> ExcCodes | None:
        """pymodbus asks before it answers."""
        if self.fault == "exception":
            return ExcCodes.DEVICE_FAILURE
        if self.fault == "silent":
            await asyncio.sleep(SILENCE_S)
        self.refresh(address, count, registers)
        if self.fault == "garbage":
            registers[address : address + count] = [0xFFFF] * count
        return None


def _words(data: bytes) -> list[int]:
    return [int(word) for word in np.frombuffer(data, ">u2")]


class ModbusFace:
    """A Modbus TCP server on loopback with one device id (1, 2, ...) per drive."""

    def __init__(self, drives: Mapping[int, LiveDrive]) -> None:
        self.sensors = {number: SensorRegisters(drive) for number, drive in drives.items()}
        self._server: ModbusTcpServer | None = None
        self.port = 0

    async def start(self, port: int = 0) -> int:
        """Listens on 127.0.0.1; the port in use (0 lets the system choose)."""
        devices = [
            SimDevice(number, [SimData(0, count=REGISTERS, values=0, datatype=DataType.REGISTERS)], action=rows.action)
            for number, rows in self.sensors.items()
        ]
        self._server = ModbusTcpServer(devices, address=("127.0.0.1", port))
        await self._server.serve_forever(background=True)
        listening: Any = self._server.transport  # asyncio.Server, which pymodbus declares as a transport
        self.port = int(listening.sockets[0].getsockname()[1])
        return self.port

    async def stop(self) -> None:
        """Closes the port."""
        if self._server:
            await self._server.shutdown()  # type: ignore[no-untyped-call]
            self._server = None

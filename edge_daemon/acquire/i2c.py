"""The devices of one I2C bus as a source. All transfers run in one thread, one after the other."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

import numpy as np

from edge_daemon.acquire.i2c_device import BurstDevice, RegisterDevice
from edge_daemon.acquire.i2c_presets import PRESETS
from edge_daemon.acquire.i2c_transfer import BusGone, DeviceError, I2cBus, NoSuchDevice, Registers
from edge_daemon.acquire.source import Sink, Tally
from edge_daemon.clock import Clock
from edge_daemon.config.settings import I2cDevice, I2cSource, SettingsError
from edge_daemon.records import Burst, Readings, SourceHealth

__all__ = ["I2c", "I2cBus", "signals_of_device"]

T = TypeVar("T")
ALL_FAIL_FOR_S = 10.0
"""Where no device at all answers for this long the bus hangs, and opening it anew may help (guess)."""
SIMULATED = "sim:"


class I2c:
    """One bus with its devices; each keeps its own period, none waits for a broken one longer than its retries."""

    def __init__(self, settings: I2cSource, opener: Callable[[int | str], I2cBus] | None) -> None:
        """`opener` opens a bus named `sim:...`. Raises `SettingsError` for an unknown part or a missing register."""
        self.name = settings.name
        self._settings = settings
        self._opener = opener
        self._tally = Tally(settings.name)
        self._answered_s = 0.0
        self._absent: set[str] = set()
        self._tasks = sum(bool(row.preset or row.registers) + bool(row.burst) for row in settings.devices)
        where = f"i2c {settings.name!r}"
        if isinstance(settings.bus, str) and not settings.bus.startswith(SIMULATED):
            raise SettingsError(f"{where}: bus: {settings.bus!r}: expected a number, or a name that begins with sim:")
        if isinstance(settings.bus, str) and opener is None:
            raise SettingsError(f"{where}: bus: {settings.bus!r} is simulated: expected the number of /dev/i2c-N here")
        if not settings.devices:
            raise SettingsError(f"{where}: devices: empty: expected at least one")
        for device in settings.devices:
            _check(f"{where}: {device.name}", device)

    def health(self) -> SourceHealth:
        """See `Source.health`."""
        return self._tally.health()

    async def run(self, sink: Sink, clock: Clock) -> None:
        """See `Source.run`."""
        self._tally.failing.clear()
        self._absent.clear()
        reason = ""
        # its own thread: the bus serialises anyway, and the shared pool stays free
        with ThreadPoolExecutor(1, thread_name_prefix=f"i2c {self.name}") as thread:
            loop = asyncio.get_running_loop()
            try:
                bus = await loop.run_in_executor(thread, self._open)
            except (OSError, ImportError) as error:
                raise self._tally.lost(f"cannot open bus {self._settings.bus}: {_reason(error)}") from error
            self._tally.set("ok")
            self._tally.count("opened")
            self._answered_s = time.monotonic()
            try:
                async with asyncio.TaskGroup() as group:
                    for device in self._settings.devices:
                        registers = Registers(bus, device.address, device.retries, self._tally.count)
                        self._start(group, thread, device, registers, sink, clock)
            except* BusGone as gone:
                reason = str(gone.exceptions[0])
            finally:
                await loop.run_in_executor(thread, bus.close)
        raise self._tally.lost(f"bus {self._settings.bus}: {reason}")

    def _open(self) -> I2cBus:
        if self._opener is not None and isinstance(self._settings.bus, str):
            return self._opener(self._settings.bus)
        from smbus2 import SMBus

        bus: I2cBus = SMBus(self._settings.bus)
        return bus

    def _start(
        self,
        group: asyncio.TaskGroup,
        thread: ThreadPoolExecutor,
        device: I2cDevice,
        registers: Registers,
        sink: Sink,
        clock: Clock,
    ) -> None:
        """The tasks of one device."""
        if device.preset or device.registers:
            values = RegisterDevice(device, registers)
            group.create_task(self._poll(thread, device, values, sink, clock))
        if device.burst:
            burst = BurstDevice(device.burst, registers)
            group.create_task(self._capture(thread, device, burst, sink, clock))

    async def _poll(
        self, thread: ThreadPoolExecutor, device: I2cDevice, values: RegisterDevice, sink: Sink, clock: Clock
    ) -> None:
        due_s = asyncio.get_running_loop().time()
        while True:
            try:
                when_s, found = await self._in(thread, values.read)
                self._answered(device.name, clock)
                at_s = clock.time_s() - (time.monotonic() - when_s)
            except DeviceError as error:
                self._failed(device.name, error)
                found, at_s = dict.fromkeys(values.signals, float("nan")), clock.time_s()
            for signal, value in found.items():
                sink(Readings(self.name, f"{device.name}.{signal}", np.array([at_s]), np.array([value])))
            due_s = await _until_next(due_s, device.period_s)

    async def _capture(
        self, thread: ThreadPoolExecutor, device: I2cDevice, burst: BurstDevice, sink: Sink, clock: Clock
    ) -> None:
        """One burst after the other; other devices are served between its chunks."""
        due_s = asyncio.get_running_loop().time()
        key = f"{device.name}.{burst.settings.signal}"
        while True:
            try:
                began_s = await self._in(thread, burst.start)
                at_s = clock.time_s() - (time.monotonic() - began_s)
                await asyncio.sleep(burst.duration_s)
                deadline_s = time.monotonic() + burst.patience_s
                while not await self._in(thread, burst.is_ready):
                    if time.monotonic() > deadline_s:
                        raise DeviceError("the capture does not end")
                    await asyncio.sleep(burst.poll_s)
                while not burst.complete:
                    await self._in(thread, burst.fetch)
                self._answered(key, clock)
                sink(Burst(self.name, key, at_s, burst.settings.rate_hz, burst.values()))
            except DeviceError as error:
                self._failed(key, error)
            due_s = await _until_next(due_s, burst.settings.every_s)

    async def _in(self, thread: ThreadPoolExecutor, job: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(thread, partial(job))

    def _answered(self, device: str, clock: Clock) -> None:
        self._tally.failing.pop(device, None)
        self._absent.discard(device)
        self._answered_s = time.monotonic()
        self._tally.count("readings")
        self._tally.last_s = clock.time_s()

    def _failed(self, device: str, error: DeviceError) -> None:
        """Raises `BusGone` where nothing on the bus has answered for long, or all that is on it is not there."""
        self._tally.count("errors")
        self._tally.failing[device] = str(error)
        if isinstance(error, NoSuchDevice):
            self._absent.add(device)
            if len(self._absent) == self._tasks:
                raise BusGone(str(error)) from error
        if time.monotonic() - self._answered_s > ALL_FAIL_FOR_S:
            raise BusGone(f"no device answers, the last was {device}: {error}") from error


def signals_of_device(device: I2cDevice) -> tuple[str, ...]:
    """`DEVICE.SIGNAL` for each value and burst."""
    names = [*PRESETS[device.preset].signals] if device.preset in PRESETS else []
    names += [row.signal for row in device.registers] + ([device.burst.signal] if device.burst else [])
    return tuple(f"{device.name}.{name}" for name in names)


def _check(where: str, device: I2cDevice) -> None:
    if device.preset and device.preset not in PRESETS:
        raise SettingsError(f"{where}: preset: {device.preset!r} is unknown: expected one of {sorted(PRESETS)}")
    if device.preset and device.registers:
        raise SettingsError(f"{where}: registers: preset {device.preset!r} has its own: expected one or the other")
    if not (device.preset or device.registers or device.burst):
        raise SettingsError(f"{where}: nothing to read: expected preset, registers or burst")
    for row in device.registers:
        if row.crc == "crc8_sensirion" and row.type.endswith(("8", "24")):
            raise SettingsError(f"{where}: {row.signal}: crc: covers words of two bytes: expected a type of 16 or 32")
    names = signals_of_device(device)
    if len(set(names)) < len(names):
        raise SettingsError(f"{where}: a signal appears twice: expected different names")
    if device.preset:
        _check_address(where, device.address, PRESETS[device.preset].addresses)


def _check_address(where: str, address: int, possible: tuple[int, ...]) -> None:
    """Raises `SettingsError` for an address that the part cannot have; `i2cdetect` prints 0x76 as a bare 76."""
    if address not in possible:
        meant = f": did you mean 0x{address}?" if int(str(address), 16) in possible else ""
        expected = " or ".join(f"0x{one:02X}" for one in possible)
        raise SettingsError(f"{where}: address: {address} is 0x{address:02X}: expected {expected}{meant}")


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


async def _until_next(due_s: float, period_s: float) -> float:
    """Waits for the next turn, and returns when it was; a slow bus is asked less often, not in a hurry."""
    loop = asyncio.get_running_loop()
    due_s = max(due_s + period_s, loop.time())
    await asyncio.sleep(due_s - loop.time())
    return due_s

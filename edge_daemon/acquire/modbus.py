"""A Modbus sensor as a source: scaled registers, waveforms, queues, band levels."""

from __future__ import annotations

import asyncio

import numpy as np

from edge_daemon.acquire.modbus_client import Gone, ModbusClient, NoAnswer, Refused
from edge_daemon.acquire.source import Sink, Tally
from edge_daemon.clock import Clock
from edge_daemon.config.settings import ModbusRead, ModbusSource, SettingsError
from edge_daemon.records import Array, Bands, Burst, Readings, SourceHealth

DTYPES = {
    "u16": ">u2",
    "i16": ">i2",
    "u32": ">u4",
    "i32": ">i4",
    "f32": ">f4",
    "waveform_i16": ">i2",
    "waveform_f32": ">f4",
    "bands_f32": ">f4",
    "fifo_i16": ">i2",
}
FIFO_VALUES = 31
"""A queue answers with at most so many values (Modbus application protocol V1.1b3, section 6.18)."""
SANE, PLAIN = (1e-20, 1e20), (1e-6, 1e9)
"""No sensor's number lies beyond the first pair of magnitudes, and nearly all lie within the second (guess)."""
SILENCES_TO_REOPEN = 3
"""A connection may be half dead after this many silences; a serial line is opened anew at once, lest a late answer be
taken for the next."""


class ModbusSensor:
    """One device, or the devices of one line. Reads are serialised; each has its own period."""

    def __init__(self, settings: ModbusSource) -> None:
        """Raises `SettingsError` if a read lacks what its type needs."""
        self.name = settings.name
        self._settings = settings
        self._tally = Tally(settings.name)
        self._lock = asyncio.Lock()
        self._silences = 0
        where = f"modbus {settings.name!r}"
        if settings.transport == "rtu" and not settings.serial:
            raise SettingsError(f"{where}: serial: missing: expected the port of the RTU line")
        if not settings.reads:
            raise SettingsError(f"{where}: reads: empty: expected at least one")
        for read in settings.reads:
            if read.type.startswith(("waveform", "fifo")) and read.rate_hz is None:
                raise SettingsError(f"{where}: reads: {read.signal}: rate_hz: missing: a {read.type} needs it")

    def health(self) -> SourceHealth:
        """See `Source.health`."""
        return self._tally.health()

    async def run(self, sink: Sink, clock: Clock) -> None:
        """See `Source.run`."""
        self._tally.failing.clear()
        self._lock = asyncio.Lock()
        client = ModbusClient(self._settings)
        reason = ""
        try:
            await self._open(client)
            async with asyncio.TaskGroup() as group:
                for read in self._settings.reads:
                    group.create_task(self._poll(client, read, sink, clock))
        except* Gone as gone:
            reason = f"{self._where}: {gone.exceptions[0]}"
        finally:
            client.close()
        raise self._tally.lost(reason)

    @property
    def _where(self) -> str:
        settings = self._settings
        return str(settings.serial) if settings.transport == "rtu" else f"{settings.host}:{settings.port}"

    async def _open(self, client: ModbusClient) -> None:
        await client.open()
        self._tally.count("opened")
        self._tally.set("ok")
        self._silences = 0

    async def _poll(self, client: ModbusClient, read: ModbusRead, sink: Sink, clock: Clock) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            async with self._lock:
                asked_s = clock.time_s()
                try:
                    record = await self.read(client, read, clock)
                except (NoAnswer, Refused) as error:
                    self._tally.count("refused" if isinstance(error, Refused) else "no_answer")
                    self._tally.failing[read.signal] = str(error)
                    record = _nothing(self.name, read, asked_s)
                    await self._after_failure(client, error)
                else:
                    self._tally.failing.pop(read.signal, None)
                    self._silences = 0
                    self._tally.count("readings")
                    self._tally.last_s = clock.time_s()
            if (task := asyncio.current_task()) and task.cancelling():  # wait_for of Python 3.11 may lose it
                raise asyncio.CancelledError
            if record is not None:
                sink(record)
            due_s = max(due_s + read.period_s, loop.time())  # a slow device is asked less often, not in a hurry
            await asyncio.sleep(due_s - loop.time())

    async def _after_failure(self, client: ModbusClient, error: Exception) -> None:
        """Opens the line anew where silence may have left it out of step. Raises `Gone`."""
        if isinstance(error, Refused):
            self._silences = 0
            return
        self._silences += 1
        if self._settings.transport == "rtu" or self._silences >= SILENCES_TO_REOPEN:
            self._tally.count("reopened")
            await client.open()
            self._silences = 0

    async def read(self, client: ModbusClient, read: ModbusRead, clock: Clock) -> Readings | Burst | Bands | None:
        """What one request brings, in the units of its channel; None where a FIFO holds nothing new."""
        before_s = clock.time_s()
        if read.type == "fifo_i16":
            values = await self._fifo(client, read)
        else:
            values = await self._values(client, read)
        if read.type == "bands_f32":
            frequency_hz, psd = values[0::2], values[1::2] * read.scale + read.offset
            if not (np.all(np.isfinite(values)) and np.all(frequency_hz > 0) and np.all(np.diff(frequency_hz) > 0)):
                raise NoAnswer("band levels that are none")
            return Bands(self.name, read.signal, before_s, frequency_hz, psd, read.averages)
        values = values * read.scale + read.offset
        if read.rate_hz is not None and read.type.startswith(("waveform", "fifo")):
            if not len(values):
                return None
            return Burst(self.name, read.signal, before_s - len(values) / read.rate_hz, read.rate_hz, values)
        middle_s = (before_s + clock.time_s()) / 2
        return Readings(self.name, read.signal, np.array([middle_s]), values)

    def _device(self, read: ModbusRead) -> int:
        return read.device_id or self._settings.device_id

    async def _values(self, client: ModbusClient, read: ModbusRead) -> Array:
        dtype = np.dtype(DTYPES[read.type])
        count = {"waveform_i16": read.count, "waveform_f32": read.count, "bands_f32": 2 * read.count}.get(read.type, 1)
        data = await client.read(self._device(read), read.table, read.address, count * dtype.itemsize // 2)
        other = np.frombuffer(data, ">u2").reshape(-1, 2)[:, ::-1].tobytes() if dtype.itemsize == 4 else data
        if read.word_order == "little":
            data, other = other, data
        values = np.frombuffer(data, dtype).astype(np.float64)
        if read.type == "f32":
            _check_word_order(float(values[0]), float(np.frombuffer(other, dtype)[0]))
        return values

    async def _fifo(self, client: ModbusClient, read: ModbusRead) -> Array:
        """All the queue holds, up to `count` values.

        Some sensors move their queue on with each read; those that follow the letter of the standard do not, and then
        the second answer is the first again.
        """
        data = part = b""
        while len(data) < 2 * read.count:
            before, part = part, await client.read_fifo(self._device(read), read.address)
            if part == before:
                break
            data += part
            if len(part) < 2 * FIFO_VALUES:
                break
        return np.frombuffer(data, ">i2").astype(np.float64)


def _check_word_order(value: float, other: float) -> None:
    """Raises `NoAnswer` for a number that only the other order of its words makes one of a sensor."""
    absurd = value != 0 and not SANE[0] < abs(value) < SANE[1]
    if absurd and PLAIN[0] < abs(other) < PLAIN[1]:
        raise NoAnswer(f"reads {value:.2g}, in the other word_order {other:.4g}: which is meant?")


def _nothing(source: str, read: ModbusRead, time_s: float) -> Readings | None:
    """A NaN where a value was due; a waveform or spectrum that failed is simply absent."""
    if read.type.startswith(("waveform", "fifo", "bands")):
        return None
    return Readings(source, read.signal, np.array([time_s]), np.array([np.nan]))

"""A Modbus TCP server for PLCs: the only module that knows pymodbus's server.

pymodbus 3.16 keeps the registers and answers well-formed reads; reading and writing its memory never suspends, so
a block changes as a whole. What it does not do stands in front of it: it waits for ever after a broken MBAP header,
leaves the second of two requests in one segment unanswered, never closes an idle client and has no limit on clients.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Iterable, Mapping

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from edge_daemon.config.settings import ModbusServer as Settings
from edge_daemon.errors import why_not_listening
from edge_daemon.publish.registers import TOTAL
from edge_daemon.publish.words import encode
from edge_daemon.records import LinkHealth, Snapshot

_READ_HOLDING = 3
_READ_INPUT = 4
_WRITE_BLOCK = 16
"""The gateway itself fills the registers under this function code; clients' writes never get here."""
_HEADER = 7
_READ_FRAME = 12
"""A read request with its header has so many bytes."""
_LENGTH_LIMITS = range(2, 255)
"""A frame has unit and function at least, 254 bytes at most (Modbus Messaging on TCP/IP Implementation Guide 1.0b,
3.1.3)."""
_MOST_REGISTERS = 125
_MOST_PENDING = 16 * 260
"""Requests may be sent ahead up to so many bytes: the guide's 16 transactions at the largest frame."""
_MOST_UNREAD = 65_536
"""A client that leaves so many bytes of answers unfetched sends but never reads, and is dropped (guess)."""
_BUSY_WITHIN_S = 1.0
"""A client that asked this recently is never dropped in favour of a new one."""


class RegisterServer:
    """Every drive's registers under its device id, as input registers and, read-only, as holding registers.

    All methods belong to the event loop that called `start`.
    """

    def __init__(self, settings: Settings, device_ids: Mapping[str, int]) -> None:
        self._settings = settings
        self._device_ids = dict(device_ids)
        self._snapshots: dict[str, Snapshot] = {}
        self._sequence = dict.fromkeys(device_ids, 0)
        self._heartbeat = 0
        self._server: _Server | None = None
        self.counts: Counter[str] = Counter()

    async def start(self, now_s: float) -> int:
        """Listen; returns the port, which matters if 0 was asked for. Raises OSError if the address is taken."""
        server = _Server(self._settings, self._device_ids.values(), self.counts)
        try:
            await server.serve_forever(background=True)
        except RuntimeError as error:
            address = f"{self._settings.host}:{self._settings.port}"
            why = why_not_listening(server.refused) if server.refused else str(error)
            raise OSError(f"cannot listen on {address}: {why}") from error
        self._server = server
        for drive in self._device_ids:
            await self._write(drive, now_s)
        return server.port

    async def stop(self) -> None:
        """Close the listener and every connection; again is fine."""
        server, self._server = self._server, None
        if server:
            await server.shutdown()  # type: ignore[no-untyped-call]

    async def publish(self, snapshot: Snapshot, now_s: float) -> None:
        """Show a drive's new state, as a whole. Drives without a device id are not shown."""
        if snapshot.drive in self._device_ids:
            self._snapshots[snapshot.drive] = snapshot
            await self._write(snapshot.drive, now_s)

    async def tick(self, now_s: float) -> None:
        """Move the heartbeat and let the data age although nothing new came; call it at least once a second."""
        self._heartbeat += 1
        for drive in self._device_ids:
            await self._write(drive, now_s)

    def health(self) -> LinkHealth:
        """Clients now, and what they asked and what was refused so far."""
        figures = dict(self.counts) | {"clients": len(self._server.clients) if self._server else 0}
        return LinkHealth("modbus", "ok" if self._server else "down", "" if self._server else "not listening", figures)

    async def _write(self, drive: str, now_s: float) -> None:
        if not self._server:
            return
        self._sequence[drive] += 1
        words = encode(
            self._snapshots.get(drive),
            now_s=now_s,
            sequence=self._sequence[drive],
            heartbeat=self._heartbeat,
            stale_after_s=self._settings.stale_after_s,
            word_order=self._settings.word_order,
        )
        await self._server.async_setValues(self._device_ids[drive], _WRITE_BLOCK, 0, words)


class _Server(ModbusTcpServer):
    """pymodbus's server with guarded connections."""

    def __init__(self, settings: Settings, device_ids: Iterable[int], counts: Counter[str]) -> None:
        self.device_ids = frozenset(device_ids)
        self.settings = settings
        self.counts = counts
        self.clients: set[_Connection] = set()
        devices = [SimDevice(id=number, simdata=_block()) for number in sorted(self.device_ids)]
        super().__init__(devices, address=(settings.host, settings.port))
        self.refused: OSError | None = None
        self._create, self.call_create = self.call_create, self._listen

    async def _listen(self) -> asyncio.AbstractServer:
        """As pymodbus does it, but for the reason of a refusal, which it only logs."""
        try:
            server: asyncio.AbstractServer = await self._create()
        except OSError as error:
            self.refused = error
            raise
        return server

    @property
    def port(self) -> int:
        """The port in use."""
        assert isinstance(self.transport, asyncio.Server)
        return int(self.transport.sockets[0].getsockname()[1])

    def callback_new_connection(self) -> _Connection:
        return _Connection(self)

    def admit(self, newcomer: _Connection) -> bool:
        """Room for one more? If need be the client that has been silent longest goes (the guide's 4.2.1.3)."""
        if len(self.clients) >= self.settings.max_clients:
            self.counts["dropped_full"] += 1
            leaving = self._leaving(newcomer)
            if leaving is None:
                return False
            leaving.drop()
        self.clients.add(newcomer)
        return True

    def _leaving(self, newcomer: _Connection) -> _Connection | None:
        """Who makes room: a silent client, else one of an address that has more than its share; nobody whose seat is
        reserved, and for a reserved newcomer anybody else."""
        reserved = self.settings.reserved
        others = [client for client in self.clients if client.address not in reserved]
        held = Counter(client.address for client in self.clients)
        share = self.settings.max_clients / len({*held, newcomer.address})
        silent = [client for client in others if self.loop.time() - client.asked_s >= _BUSY_WITHIN_S]
        crowd = [client for client in others if held[client.address] > share and client.address != newcomer.address]
        rest = others if newcomer.address in reserved else []
        return min(silent or crowd or rest, key=lambda client: client.asked_s, default=None)


def _block() -> list[SimData]:
    return [SimData(address=0, count=TOTAL, values=0, datatype=DataType.REGISTERS)]


class _Connection(ServerRequestHandler):
    """One client. Hands pymodbus one whole, valid read at a time; answers or drops everything else itself."""

    def __init__(self, server: _Server) -> None:
        super().__init__(server, None, None, None)  # type: ignore[no-untyped-call]
        self._server = server
        self._pending = b""
        self._answering = False
        self._timer: asyncio.TimerHandle | None = None
        self.asked_s = self.loop.time()
        self.address = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        if not self._server.admit(self):
            self.drop()
            return
        self._server.counts["connections"] += 1
        self._timer = self.loop.call_later(self._server.settings.idle_s, self._look_idle)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.clients.discard(self)
        if self._timer:
            self._timer.cancel()
        super().connection_lost(exc)

    def drop(self, reason: str = "") -> None:
        """Close now, without waiting for the client to read; `reason` names the counter."""
        self._server.clients.discard(self)
        self._pending = b""
        if reason:
            self._server.counts[reason] += 1
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        self._pending += data
        if len(self._pending) > _MOST_PENDING:
            self.drop("dropped_flood")
        self._pump()

    async def handle_request(self) -> None:
        try:
            await super().handle_request()  # type: ignore[no-untyped-call]
        finally:
            self._answering = False
            self._pump()

    def _pump(self) -> None:
        """Take whole frames from what arrived, one answer after the other, in their order."""
        while not self._answering and len(self._pending) >= _HEADER:
            size = self._frame_size()
            if size is None:
                self.drop("dropped_broken_header")
                return
            if len(self._pending) < size:
                return
            frame, self._pending = self._pending[:size], self._pending[size:]
            self._answer(frame)

    def _frame_size(self) -> int | None:
        """Bytes of the frame that begins the buffer; None if its header is none."""
        protocol = int.from_bytes(self._pending[2:4], "big")
        length = int.from_bytes(self._pending[4:6], "big")
        return 6 + length if protocol == 0 and length in _LENGTH_LIMITS else None

    def _answer(self, frame: bytes) -> None:
        if self._unread_bytes() > _MOST_UNREAD:
            self.drop("dropped_not_reading")
            return
        self.asked_s = self.loop.time()
        self._server.counts["requests"] += 1
        refusal = self._refusal(frame)
        if refusal is not None:
            self._refuse(frame, refusal)
            return
        self._answering = True
        super().data_received(frame)
        if not self.last_pdu:  # pymodbus did not take it after all: never leave a client waiting
            self._answering = False
            self._refuse(frame, ExcCodes.DEVICE_FAILURE)

    def _refusal(self, frame: bytes) -> ExcCodes | None:
        if frame[7] not in (_READ_HOLDING, _READ_INPUT):
            return ExcCodes.ILLEGAL_FUNCTION
        if frame[6] not in self._server.device_ids:
            return ExcCodes.GATEWAY_NO_RESPONSE
        if len(frame) != _READ_FRAME or not 1 <= int.from_bytes(frame[10:12], "big") <= _MOST_REGISTERS:
            return ExcCodes.ILLEGAL_VALUE
        return None

    def _refuse(self, frame: bytes, code: ExcCodes) -> None:
        self._server.counts["refused"] += 1
        if isinstance(self.transport, asyncio.WriteTransport):
            self.transport.write(frame[:4] + b"\x00\x03" + frame[6:7] + bytes((frame[7] | 0x80, code)))

    def _unread_bytes(self) -> int:
        if isinstance(self.transport, asyncio.WriteTransport):
            return self.transport.get_write_buffer_size()
        return 0

    def _look_idle(self) -> None:
        left_s = self.asked_s + self._server.settings.idle_s - self.loop.time()
        if left_s <= 0:
            self.drop("dropped_idle")
        else:
            self._timer = self.loop.call_later(left_s, self._look_idle)

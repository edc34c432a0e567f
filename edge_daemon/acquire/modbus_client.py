"""The one place that knows pymodbus's client. Its interface changes with every minor release; ours does not."""

from __future__ import annotations

import asyncio
import logging
import struct
from collections.abc import Awaitable, Callable
from typing import Any, Literal

from edge_daemon.acquire.source import not_there
from edge_daemon.config.settings import ModbusSource

REGISTERS_PER_READ = 125
"""Modbus application protocol V1.1b3, section 6.3"""
REFUSALS = {
    1: "it cannot read in this way: the other table?",
    2: "it has no such registers: table, address, type?",
    3: "it does not give so many at once: count?",
    4: "it has failed",
    6: "it is busy",
    10: "the gateway before it finds no way: device_id?",
    11: "nobody answers behind the gateway: device_id?",
}
"""Each exception code has a meaning and something to look at (Modbus application protocol V1.1b3, section 7)."""
PATIENCE = 1.5
"""The outer limit is this many times the client's own; it ends a request that the library forgot."""


class NoAnswer(Exception):
    """Silence, or nothing that can be understood."""


class Refused(Exception):
    """The device answered with an exception code."""


class Gone(Exception):
    """The connection or the port is closed."""


class ModbusClient:
    """One connection to a device, or to the devices of a line. Not for concurrent use: the caller serialises."""

    def __init__(self, settings: ModbusSource) -> None:
        self._settings = settings
        self._client: Any = None

    async def open(self) -> None:
        """Connects. Raises `Gone`."""
        from pymodbus.exceptions import ModbusException

        self.close()
        missing = not_there(self._settings.serial or "") if self._settings.transport == "rtu" else ""
        if missing:
            raise Gone(missing)
        try:
            self._client = self._new()
            self._client.register(_fifo_response())
            async with asyncio.timeout(PATIENCE * self._settings.timeout_s):
                connected = await self._client.connect()
        except (ModbusException, OSError, ValueError, RuntimeError) as error:
            self.close()
            raise Gone(str(error) or type(error).__name__) from error
        if not connected:
            self.close()
            raise Gone("nobody answers there")

    def _new(self) -> Any:
        from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

        # a sensor that is switched off would write an error a second; what matters is counted, and told once
        logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
        settings = self._settings
        # one attempt, no hidden reconnection: retries and back-off are decided outside
        common: dict[str, Any] = {"timeout": settings.timeout_s, "retries": 0, "reconnect_delay": 0}
        if settings.transport == "rtu":
            return AsyncModbusSerialClient(
                settings.serial or "", baudrate=settings.baud, parity=settings.parity, **common
            )
        return AsyncModbusTcpClient(settings.host, port=settings.port, **common)

    def close(self) -> None:
        """Hangs up; harmless if closed."""
        if self._client is not None:
            self._client.close()
            self._client = None

    async def read(self, device_id: int, table: Literal["input", "holding"], address: int, count: int) -> bytes:
        """`count` registers as bytes, big-endian. Raises `Refused`, `NoAnswer`, `Gone`."""
        words = bytearray()
        while count > 0:
            part = min(count, REGISTERS_PER_READ)
            function = "read_input_registers" if table == "input" else "read_holding_registers"
            registers = (await self._ask(function, device_id=device_id, address=address, count=part)).registers
            if len(registers) != part:
                raise NoAnswer(f"{len(registers)} registers came where {part} were asked for")
            words += struct.pack(f">{part}H", *registers)
            address, count = address + part, count - part
        return bytes(words)

    async def read_fifo(self, device_id: int, address: int) -> bytes:
        """What the queue at `address` holds, at most 31 registers, as bytes. Raises as `read`."""
        answer = await self._ask("read_fifo_queue", device_id=device_id, address=address)
        return struct.pack(f">{len(answer.values)}H", *answer.values)

    async def _ask(self, function: str, **what: int) -> Any:
        from pymodbus.exceptions import ConnectionException, ModbusException

        if self._client is None or not self._client.connected:
            raise Gone("the connection is closed")
        ask: Callable[..., Awaitable[Any]] = getattr(self._client, function)
        try:
            async with asyncio.timeout(PATIENCE * self._settings.timeout_s):
                answer = await ask(**what)
        except (ConnectionException, OSError) as error:
            if isinstance(error, TimeoutError):
                raise NoAnswer("no answer") from error
            raise Gone(str(error) or type(error).__name__) from error
        except ModbusException as error:
            if not self._client.connected:
                raise Gone("the connection was closed") from error
            raise NoAnswer("no answer" if "No response" in str(error) else "a broken answer") from error
        except (struct.error, ValueError, IndexError, TypeError) as error:  # the library's parser met rubbish
            raise NoAnswer("a broken answer") from error
        if answer.isError():
            code = getattr(answer, "exception_code", 0)
            raise Refused(": ".join(filter(None, (f"exception code {code}", REFUSALS.get(code)))))
        return answer


def _fifo_response() -> type[Any]:
    """pymodbus 3.16 takes the answer on a serial line for two bytes shorter than it is, and finds its checksum wrong.

    Modbus application protocol V1.1b3, section 6.18: the length counts what follows it; before it stand device and
    function, after it the checksum: four bytes and the length itself, two.
    """
    from pymodbus.pdu.file_message import ReadFifoQueueResponse

    class Response(ReadFifoQueueResponse):
        @classmethod
        def calculateRtuFrameSize(cls, data: bytes) -> int:
            return int.from_bytes(data[2:4], "big") + 6

    return Response

"""What a gateway may ask and tell CANopen nodes before it listens: who they are, what to send, and to start.

CiA 301: service data (SDO) in its expedited form, which carries up to four bytes in one frame, and network management
(NMT). Everything blocks. Nothing here enables a drive: that is done by its controlword alone.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from edge_daemon.acquire.canopen_objects import OBJECTS
from edge_daemon.config.settings import CanSource, Pdo

SDO_REQUEST_ID, SDO_ANSWER_ID = 0x600, 0x580
"""CiA 301, predefined connection set: plus the node."""
NMT_ID = 0x000
NMT_START, NMT_PREOPERATIONAL = 0x01, 0x80
DEVICE_TYPE = 0x1000
"""Its low sixteen bits are the number of the device profile, such as 402 or 406."""
PDO_PARAMETERS, PDO_MAPPING = 0x1800, 0x1A00
FIRST_PDO_ID, PDO_ID_STEP, PDOS = 0x180, 0x100, 4
"""CiA 301, predefined connection set: transmit PDO n of a node is at 0x180 + 0x100 (n - 1) + node."""
PDO_INVALID = 1 << 31
EVERY_SYNC, ON_EVENT = 1, 255
"""Transmission types: at each SYNC, and as the device profile decides."""
ANSWER_WITHIN_S = 0.3
"""A node answers within milliseconds; a busy bus delays it a little (guess)."""
ABORTS = {
    0x0601_0000: "not supported",
    0x0601_0002: "read only",
    0x0602_0000: "no such object",
    0x0604_0041: "cannot be mapped",
    0x0604_0042: "longer than a PDO",
    0x0800_0022: "not in its present state",
}
"""Abort codes that a mapping meets (CiA 301, SDO abort transfer protocol)."""


class NodeRefused(Exception):
    """One line: which node does not do what, and why."""


class Sdo:
    """Single objects of one node, on an open python-can bus that nobody else reads."""

    def __init__(self, bus: Any, node: int) -> None:
        self._bus = bus
        self._node = node

    def read(self, index: int, sub: int) -> int:
        """An unsigned number of up to four bytes. Raises `NodeRefused`."""
        answer = self._asked(bytes([0x40, *index.to_bytes(2, "little"), sub, 0, 0, 0, 0]))
        if not answer[0] & 0x02:
            raise NodeRefused(f"node {self._node}: 0x{index:04X}:{sub} is longer than four bytes")
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little")

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        """`size` bytes, 1 to 4. Raises `NodeRefused`."""
        command = 0x23 | (4 - size) << 2
        self._asked(bytes([command, *index.to_bytes(2, "little"), sub, *value.to_bytes(4, "little")]))

    def _asked(self, request: bytes) -> bytes:
        where = f"node {self._node}: 0x{int.from_bytes(request[1:3], 'little'):04X}:{request[3]}"
        _send(self._bus, SDO_REQUEST_ID + self._node, request)
        until_s = time.monotonic() + ANSWER_WITHIN_S
        while (left_s := until_s - time.monotonic()) > 0:
            message = self._bus.recv(left_s)
            if message is None or message.arbitration_id != SDO_ANSWER_ID + self._node or len(message.data) < 8:
                continue
            answer = bytes(message.data)
            if answer[1:4] != request[1:4]:
                continue
            if answer[0] == 0x80:
                code = int.from_bytes(answer[4:], "little")
                raise NodeRefused(f"{where}: refused with 0x{code:08X}{_meaning(code)}")
            return answer
        raise NodeRefused(f"{where}: no answer: powered, on this bus, and of this number?")


def set_up(bus: Any, settings: CanSource) -> None:
    """Maps and starts the nodes of a section as far as it allows. Raises `NodeRefused`."""
    if settings.map_pdos:
        for node in sorted({pdo.node for pdo in settings.pdo}):
            command_node(bus, NMT_PREOPERATIONAL, node)
        for pdo in settings.pdo:
            _map(Sdo(bus, pdo.node), pdo, settings.sync_period_s is not None)
    if settings.start_nodes or settings.map_pdos:
        for node in sorted({pdo.node for pdo in settings.pdo}):
            command_node(bus, NMT_START, node)


def command_node(bus: Any, command: int, node: int) -> None:
    """Network management; no answer is foreseen. Raises `NodeRefused` where nothing can be sent."""
    _send(bus, NMT_ID, bytes([command, node]))


def number_of(pdo: Pdo) -> int:
    """Which of its node's transmit PDOs it is, from 1; 0 where the identifier is none of the predefined ones."""
    number, rest = divmod(pdo.cob_id - pdo.node - FIRST_PDO_ID, PDO_ID_STEP)
    return number + 1 if rest == 0 and 0 <= number < PDOS else 0


def mapped_objects(sdo: Sdo, number: int) -> Iterator[str]:
    """Names of what transmit PDO `number` of a node carries, `0x2000:1` where none is known. Raises `NodeRefused`."""
    known = {(row.index, row.sub): row.name for row in OBJECTS.values()}
    for sub in range(1, sdo.read(PDO_MAPPING + number - 1, 0) + 1):
        entry = sdo.read(PDO_MAPPING + number - 1, sub)
        place = (entry >> 16, entry >> 8 & 0xFF)
        yield known.get(place, f"0x{place[0]:04X}:{place[1]}")


def _map(sdo: Sdo, pdo: Pdo, produces_sync: bool) -> None:
    """CiA 301, PDO mapping procedure: invalid while it is changed. The identifier stays what it was."""
    number = number_of(pdo)
    if not number:
        raise NodeRefused(f"node {pdo.node}: 0x{pdo.cob_id:03X}: expected 0x{FIRST_PDO_ID + pdo.node:03X} or such")
    parameters, mapping = PDO_PARAMETERS + number - 1, PDO_MAPPING + number - 1
    rows = [OBJECTS[name] for name in pdo.objects]
    synchronous = produces_sync if pdo.synchronous is None else pdo.synchronous
    sdo.write(parameters, 1, pdo.cob_id | PDO_INVALID, 4)
    sdo.write(parameters, 2, EVERY_SYNC if synchronous else ON_EVENT, 1)
    sdo.write(mapping, 0, 0, 1)
    for sub, row in enumerate(rows, start=1):
        sdo.write(mapping, sub, row.index << 16 | row.sub << 8 | row.bits, 4)
    sdo.write(mapping, 0, len(rows), 1)
    sdo.write(parameters, 1, pdo.cob_id, 4)


def _send(bus: Any, identifier: int, data: bytes) -> None:
    import can

    try:
        bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
    except (can.CanError, OSError) as error:
        raise NodeRefused(f"cannot send: {error}") from error


def _meaning(code: int) -> str:
    return f": {ABORTS[code]}" if code in ABORTS else ""

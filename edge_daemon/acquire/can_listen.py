"""Who is on a CAN bus: every identifier with its rate and its CiA 301 name, and what its nodes say of themselves."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from edge_daemon.acquire.can_bus import open_interface
from edge_daemon.acquire.canopen_objects import OBJECTS, SYNC_ID
from edge_daemon.acquire.canopen_setup import DEVICE_TYPE, FIRST_PDO_ID, PDOS, NodeRefused, Sdo, mapped_objects
from edge_daemon.config.settings import CanSource

NODE_MASK, FUNCTION_MASK = 0x07F, 0x780
"""CiA 301, predefined connection set: an identifier is four bits of function and seven of node."""
NODE_STATES = {0: "has just started", 4: "is stopped", 5: "is operational", 127: "is pre-operational, sends no PDO"}
"""What the byte of a heartbeat means (CiA 301, NMT error control)."""
TRANSMIT_PDOS = {FIRST_PDO_ID + 0x100 * n: f"PDO {n + 1} of node" for n in range(PDOS)}
FUNCTIONS = {
    **TRANSMIT_PDOS,
    **{0x200 + 0x100 * n: f"received PDO {n + 1} of node" for n in range(PDOS)},
    0x080: "emergency of node",
    0x580: "SDO answer of node",
    0x600: "SDO request to node",
    0x700: "heartbeat of node",
}
HEARTBEAT = 0x700


@dataclass(slots=True)
class HeardMessage:
    """All frames of one identifier."""

    identifier: int
    extended: bool
    length: int
    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    payload: bytes = b""
    """of the newest"""

    @property
    def rate_hz(self) -> float:
        """NaN of a single frame."""
        return (self.count - 1) / (self.last_s - self.first_s) if self.last_s > self.first_s else float("nan")

    @property
    def node(self) -> int:
        """The CANopen node that CiA 301 gives this identifier to; 0 of none."""
        known = not self.extended and self.identifier & FUNCTION_MASK in FUNCTIONS
        return self.identifier & NODE_MASK if known else 0

    @property
    def meaning(self) -> str:
        """What it is on a CANopen bus; empty where CiA 301 says nothing."""
        if not self.extended and self.identifier in (0, SYNC_ID):
            return "SYNC" if self.identifier else "network management"
        if not self.node:
            return ""
        text = f"{FUNCTIONS[self.identifier & FUNCTION_MASK]} {self.node}"
        state = NODE_STATES.get(self.payload[0] & 0x7F) if self.payload else None
        return f"{text}: {state}" if self.identifier & FUNCTION_MASK == HEARTBEAT and state else text


@dataclass(frozen=True, slots=True)
class HeardNode:
    """What a CANopen node says when it is asked."""

    node: int
    profile: int
    """402 of drives, 406 of encoders; 0 where it does not say"""
    pdos: dict[int, tuple[str, ...]]
    """identifier -> names of the objects that are mapped into it"""


def listened(settings: CanSource, seconds: float) -> tuple[list[HeardMessage], list[HeardNode]]:
    """What comes by within `seconds`, and the nodes among it or in the settings. Blocks. Raises `LinkDown`."""
    bus = open_interface(settings)
    try:
        heard = _heard(bus, seconds)
        nodes = {pdo.node for pdo in settings.pdo}
        if settings.dbc is None:
            nodes |= {message.node for message in heard if message.node}
        return heard, [found for node in sorted(nodes) if (found := _asked(bus, node))]
    finally:
        bus.shutdown()


def _heard(bus: Any, seconds: float) -> list[HeardMessage]:
    found: dict[tuple[int, bool], HeardMessage] = {}
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        message = bus.recv(left_s)
        if message is None or message.is_error_frame or message.is_remote_frame:
            continue
        key = (message.arbitration_id, message.is_extended_id)
        now_s = message.timestamp or time.time()
        row = found.setdefault(key, HeardMessage(*key, len(message.data), first_s=now_s))
        row.count, row.last_s, row.payload = row.count + 1, now_s, bytes(message.data)
    return [found[key] for key in sorted(found)]


def _asked(bus: Any, node: int) -> HeardNode | None:
    """None of a node that does not answer."""
    sdo = Sdo(bus, node)
    pdos: dict[int, tuple[str, ...]] = {}
    try:
        profile = _profile(sdo)
        for number in range(1, PDOS + 1):
            objects = tuple(mapped_objects(sdo, number))
            if objects:
                pdos[FIRST_PDO_ID + 0x100 * (number - 1) + node] = objects
    except NodeRefused as error:
        if "no answer" in str(error) and not pdos:
            return None
    return HeardNode(node, profile, pdos)


def _profile(sdo: Sdo) -> int:
    try:
        return sdo.read(DEVICE_TYPE, 0) & 0xFFFF
    except NodeRefused as error:
        if "no answer" in str(error):
            raise
        return 0


def proposed(message: HeardMessage, nodes: list[HeardNode]) -> str:
    """A line of `pdo` that would read this message; empty of what is no transmit PDO or carries unknown objects."""
    if message.extended or message.identifier & FUNCTION_MASK not in TRANSMIT_PDOS or not message.node:
        return ""
    mapped = next((n.pdos[message.identifier] for n in nodes if message.identifier in n.pdos), ())
    if not mapped or any(name not in OBJECTS for name in mapped):
        return ""
    names = ", ".join(f'"{name}"' for name in mapped)
    return f"{{ node = {message.node}, cob_id = 0x{message.identifier:03X}, objects = [{names}] }}"

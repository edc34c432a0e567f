"""The wall between the runner and a CiA 402 drive on CANopen: configuration by SDO, motion by PDO and SYNC.

The drive is told to watch this gateway's heartbeat (0x1016) and to quick-stop when it is missing (0x6007). A drive that
refuses either is not moved: nothing would stop it if this process were killed.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import can
import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable, datatypes

from edge_daemon.config.settings import Excite
from edge_daemon.errors import BadInput
from edge_daemon.excite.limits import Feedback
from edge_daemon.excite.sequence import STANDSTILL_RAD_S, Command, DriveState, state_of

CYCLIC_POSITION, CYCLIC_VELOCITY = 8, 9
QUICK_STOP_ON_LOSS = 3
"""0x6007, abort connection option: quick stop"""
SLOW_DOWN_AND_DISABLE = 2
"""0x605A, quick stop option: down the quick stop ramp, then switch on disabled"""
HEARTBEATS_PER_TIMEOUT = 4
"""Three heartbeats of these may be lost."""
EACH_SYNC = 1
"""PDO transmission type"""
OPERATIONAL = 5
COUNTS_MAX = 2**31 - 1
SDO_TIMEOUT_S = 0.5
FINE_CYCLE_S = 0.0255
"""A longer cycle does not fit the one byte of object 0x60C2 in tenths of a millisecond."""


class LinkLost(Exception):
    """Nothing can be sent or heard any more; one line why."""


class DriveRefused(BadInput):
    """One line: what the drive does not take or where it stands that forbids motion."""


class CanopenDrive:
    """One drive behind a `canopen.Network`. `now` is a monotonic clock [s]; `answer_s` by the wall clock."""

    def __init__(
        self,
        network: canopen.Network,
        settings: Excite,
        now: Callable[[], float],
        answer_s: float = SDO_TIMEOUT_S,
    ) -> None:
        self._network = network
        self._settings = settings
        self._now = now
        self._node = canopen.RemoteNode(settings.node, _dictionary())
        self._node.sdo.RESPONSE_TIMEOUT = answer_s
        network.add_node(self._node)
        self._double = False
        network.subscribe(0x700 + settings.gateway_node, self._doubled)
        self._lock = threading.Lock()
        self._latest: dict[int, int] = {}
        self._heard_s = {0x6041: -math.inf, 0x606C: -math.inf}
        self._due_s = -math.inf
        self._rad_per_count = 2 * math.pi / settings.counts_per_turn

    def _doubled(self, *_frame: object) -> None:
        self._double = True

    def doubts(self) -> str:
        """Why the drive would not notice the end of this process; empty if it would."""
        if self._double:
            return (
                f"another node sends the heartbeat of node {self._settings.gateway_node}: choose another gateway_node"
            )
        return ""

    def prepare(self) -> Feedback:
        """Configure the drive, which must stand still without fault, and start its process data.

        Returns where it stands. Raises `DriveRefused`, `LinkLost`.
        """
        try:
            self._node.nmt.state = "PRE-OPERATIONAL"
            seen = self._look()
            self._configure()
            self._heartbeat(self._now())
            self._node.nmt.state = "OPERATIONAL"
        except canopen.SdoAbortedError as error:
            raise DriveRefused(f"drive node {self._settings.node}: refuses its configuration: {error}") from error
        except (canopen.SdoCommunicationError, can.CanError, RuntimeError, OSError) as error:
            raise LinkLost(f"drive node {self._settings.node}: {error}") from error
        return seen

    def _look(self) -> Feedback:
        sdo = self._node.sdo
        status, position, speed = (int(sdo[index].raw) for index in (0x6041, 0x6064, 0x606C))
        state = state_of(status)
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION, DriveState.ENABLED):
            raise DriveRefused(f"drive node {self._settings.node}: is in '{state.value}': expected it switched off")
        if abs(speed) * self._rad_per_count > STANDSTILL_RAD_S:
            turns = f"{speed * self._rad_per_count:.3g} rad/s"
            raise DriveRefused(f"drive node {self._settings.node}: turns at {turns}: expected it at rest")
        if self._settings.limits.speed_rad_s / self._rad_per_count > COUNTS_MAX:
            raise DriveRefused(f"drive node {self._settings.node}: limits.speed_rad_s: more counts/s than 32 bits hold")
        if abs(position) + self._settings.limits.travel_rad / self._rad_per_count > COUNTS_MAX:
            raise DriveRefused(f"drive node {self._settings.node}: position {position} is too near its counter's end")
        return self._feedback(status, position, speed, 0, self._now())

    def _configure(self) -> None:
        sdo, it = self._node.sdo, self._settings
        mode = CYCLIC_POSITION if it.mode == "position" else CYCLIC_VELOCITY
        timeout_ms = round(it.heartbeat_s * 1000)
        sdo[0x1016][1].raw = it.gateway_node << 16 | timeout_ms
        sdo[0x6007].raw = QUICK_STOP_ON_LOSS
        sdo[0x605A].raw = SLOW_DOWN_AND_DISABLE
        sdo[0x6060].raw = mode
        power = -4 if it.cycle_s < FINE_CYCLE_S else -3
        sdo[0x60C2][1].raw = round(it.cycle_s * 10**-power)
        sdo[0x60C2][2].raw = power
        for entry, wanted in ((sdo[0x1016][1], it.gateway_node << 16 | timeout_ms), (sdo[0x6007], QUICK_STOP_ON_LOSS)):
            if entry.raw != wanted:
                raise DriveRefused(f"drive node {it.node}: 0x{entry.index:04X} keeps {entry.raw}: it would not stop")
        target = 0x607A if it.mode == "position" else 0x60FF
        _map(self._node.rpdo[1], 0x200 + it.node, (0x6040, target))
        _map(self._node.tpdo[1], 0x180 + it.node, (0x6041, 0x6064, 0x6077))
        _map(self._node.tpdo[2], 0x280 + it.node, (0x606C,))
        for number in (1, 2):
            self._node.tpdo[number].add_callback(self._received)

    def _received(self, message: Any) -> None:
        with self._lock:
            self._latest.update((variable.index, int(variable.raw)) for variable in message.map)
            self._heard_s[message.map[0].index] = self._now()

    def feedback(self) -> Feedback | None:
        """What the drive said at the last SYNC that it answered; None before the first."""
        with self._lock:
            if not {0x6041, 0x6064, 0x6077, 0x606C} <= self._latest.keys():
                return None
            words = [self._latest[index] for index in (0x6041, 0x6064, 0x606C, 0x6077)]
            return self._feedback(words[0], words[1], words[2], words[3], min(self._heard_s.values()))

    def _feedback(self, status: int, position: int, speed: int, torque: int, time_s: float) -> Feedback:
        scale = self._rad_per_count
        return Feedback(position * scale, speed * scale, torque * 1e-3 * self._settings.rated_torque_Nm, status, time_s)

    def send(self, command: Command) -> None:
        """Targets, then SYNC, then the heartbeat when due. From the guarded loop only: a loop that hangs falls silent.

        Raises `LinkLost`.
        """
        target = command.position_rad if self._settings.mode == "position" else command.velocity_rad_s
        pdo = self._node.rpdo[1]
        try:
            pdo[0].raw = command.controlword
            pdo[1].raw = round(target / self._rad_per_count)
            pdo.transmit()
            if self._settings.sync:
                self._network.sync.transmit()
            if command.heartbeat:
                self._heartbeat(self._now())
        except (can.CanError, RuntimeError, OSError) as error:
            raise LinkLost(f"bus: {error}") from error

    def _heartbeat(self, now_s: float) -> None:
        if now_s >= self._due_s:
            self._network.send_message(0x700 + self._settings.gateway_node, bytes([OPERATIONAL]))
            self._due_s = now_s + self._settings.heartbeat_s / HEARTBEATS_PER_TIMEOUT

    def standing(self) -> bool:
        """Whether the drive, asked by SDO, says that it stands and is no longer in operation: it may have left process
        data to stop by itself. One that is enabled stands only until its next target."""
        try:
            speed = int(self._node.sdo[0x606C].raw) * self._rad_per_count
            state = state_of(int(self._node.sdo[0x6041].raw))
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError, can.CanError, RuntimeError, OSError):
            return False
        return abs(speed) < STANDSTILL_RAD_S and state not in (DriveState.ENABLED, DriveState.UNKNOWN)

    def release(self) -> None:
        """After a confirmed stop: the drive need not watch this gateway any longer. Failures are ignored, since the
        drive is then told by our silence."""
        try:
            self._node.sdo[0x1016][1].raw = 0
            self._node.nmt.state = "PRE-OPERATIONAL"
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError, can.CanError, RuntimeError, OSError):
            return


def _map(pdo: Any, cob_id: int, objects: tuple[int, ...]) -> None:
    """The objects into this PDO, sent or taken at each SYNC; read back, since a wrong mapping moves wrong things."""
    pdo.clear()
    for index in objects:
        pdo.add_variable(index)
    pdo.cob_id, pdo.trans_type, pdo.enabled = cob_id, EACH_SYNC, True
    wanted = [variable.index << 16 | variable.length for variable in pdo.map]
    pdo.save()
    kept = [int(pdo.map_array[sub].raw) for sub in range(1, len(objects) + 1)]
    if kept != wanted or pdo.map_array[0].raw != len(objects):
        raise DriveRefused(
            f"PDO 0x{cob_id:03X}: the drive maps {[hex(k) for k in kept]}: expected {[hex(w) for w in wanted]}"
        )


_VARIABLES = (
    (0x6007, "abort connection option", datatypes.INTEGER16),
    (0x6040, "controlword", datatypes.UNSIGNED16),
    (0x6041, "statusword", datatypes.UNSIGNED16),
    (0x605A, "quick stop option", datatypes.INTEGER16),
    (0x6060, "mode of operation", datatypes.INTEGER8),
    (0x6064, "position actual", datatypes.INTEGER32),
    (0x606C, "velocity actual", datatypes.INTEGER32),
    (0x6077, "torque actual", datatypes.INTEGER16),
    (0x607A, "target position", datatypes.INTEGER32),
    (0x60FF, "target velocity", datatypes.INTEGER32),
)


def _dictionary() -> canopen.ObjectDictionary:
    """The objects of CiA 301 and CiA 402-2 that this gateway uses."""
    book = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    for index, name, kind in _VARIABLES:
        book.add_object(_variable(name, index, 0, kind))
    watch = ODArray("consumer heartbeat", 0x1016)
    watch.add_member(_variable("count", 0x1016, 0, datatypes.UNSIGNED8))
    watch.add_member(_variable("watched", 0x1016, 1, datatypes.UNSIGNED32))
    book.add_object(watch)
    interpolation = ODRecord("interpolation time", 0x60C2)
    interpolation.add_member(_variable("value", 0x60C2, 1, datatypes.UNSIGNED8))
    interpolation.add_member(_variable("power of ten", 0x60C2, 2, datatypes.INTEGER8))
    book.add_object(interpolation)
    for number in (0x1400, 0x1800, 0x1801):
        _add_pdo(book, number)
    return book


def _add_pdo(book: canopen.ObjectDictionary, index: int) -> None:
    record = ODRecord(f"PDO 0x{index:04X}", index)
    record.add_member(_variable("COB-ID", index, 1, datatypes.UNSIGNED32))
    record.add_member(_variable("transmission type", index, 2, datatypes.UNSIGNED8))
    book.add_object(record)
    mapping = ODRecord(f"mapping 0x{index:04X}", index + 0x200)  # as an array, canopen would skip what is not counted
    mapping.add_member(_variable("count", index + 0x200, 0, datatypes.UNSIGNED8))
    for sub in range(1, 5):
        mapping.add_member(_variable(f"object {sub}", index + 0x200, sub, datatypes.UNSIGNED32))
    book.add_object(mapping)


def _variable(name: str, index: int, sub: int, kind: int) -> ODVariable:
    variable = ODVariable(name, index, sub)
    variable.data_type = kind
    return variable

"""A servo drive after CiA 402-2 on CANopen, and the motor that it moves.

Frames in, frames out, time given: `Cia402Face` needs no bus, so a test may run it in its own time; `serve` puts it on
any python-can bus in real time. Speaks NMT, expedited SDO, PDO on SYNC with any mapping, EMCY, and watches the
heartbeat of its master (0x1016): when that is missing it quick-stops by itself.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edge_daemon.rig.motion import MotorCourse
from edge_daemon.rig.plant import SUBSTEP_S, Plant, stages

DriveFrame = tuple[int, bytes]
"""Identifier and data."""

STEP_S = 4 * SUBSTEP_S
"""The drive's own position loop runs at 2 kHz."""
LOOP_RAD_S = 250.0
"""The position loop has this bandwidth, 40 Hz, as small servos are tuned."""
LOOP_DAMPING = 0.8
BRAKE_RAD_S2 = 4000.0
"""A motor without voltage is braked so."""
STANDING_RAD_S = 0.02
TURN_RAD = 6.283185307179586

NOT_FOUND, READ_ONLY = 0x0602_0000, 0x0601_0002
LOST_MASTER, LOST_ENCODER, FOLLOWING = 0x8130, 0x7305, 0x8611
"""Error codes of CiA 301 and CiA 402-1."""
QUICK_STOP_OPTION_STAY = 5
"""0x605A from here on: stay in quick stop active"""

STATUS = {
    "switch on disabled": 0x0250,
    "ready to switch on": 0x0231,
    "switched on": 0x0233,
    "operation enabled": 0x1237,
    "quick stop active": 0x0217,
    "fault reaction active": 0x021F,
    "fault": 0x0218,
}


@dataclass(slots=True)
class Motor:
    """The shaft. What a test may do to it: load it, block it, hang a gear on it."""

    inertia_kg_m2: float = 1e-4
    torque_limit_Nm: float = 2.0
    load_Nm: float = 0.0
    blocked: bool = False
    plant: Plant | None = None
    """a gear on the shaft; its output angle is `theta_out_rad`"""
    position_rad: float = 0.0
    velocity_rad_s: float = 0.0
    torque_Nm: float = 0.0

    @property
    def theta_out_rad(self) -> float:
        """Output angle of the gear; the motor's over nothing without one."""
        if self.plant is None:
            return self.position_rad
        at = MotorCourse(np.array([self.position_rad]), np.array([self.velocity_rad_s]), np.zeros(1))
        return float(self.plant.input_angle(at).angle[0] - self.plant.phi_rad)

    def step(self, position_rad: float, velocity_rad_s: float, *, powered: bool) -> None:
        """One step of the position loop towards the reference, or of the brake."""
        if powered:
            pull = LOOP_RAD_S**2 * (position_rad - self.position_rad)
            pull += 2 * LOOP_DAMPING * LOOP_RAD_S * (velocity_rad_s - self.velocity_rad_s)
            limit = self.torque_limit_Nm
            self.torque_Nm = min(limit, max(-limit, self.inertia_kg_m2 * pull + self.load_Nm))
            acceleration = (self.torque_Nm - self.load_Nm) / self.inertia_kg_m2
        else:
            self.torque_Nm = 0.0
            least = abs(self.velocity_rad_s) / STEP_S
            acceleration = -min(BRAKE_RAD_S2, least) * (1 if self.velocity_rad_s > 0 else -1)
        if self.blocked:
            acceleration = -self.velocity_rad_s / STEP_S
        self._turn(acceleration)

    def _turn(self, acceleration: float) -> None:
        before, start = self.velocity_rad_s, self.position_rad
        self.velocity_rad_s += acceleration * STEP_S
        self.position_rad += 0.5 * (before + self.velocity_rad_s) * STEP_S
        if self.plant is not None:
            t = stages(0, round(STEP_S / SUBSTEP_S))
            angle = start + before * t + 0.5 * acceleration * t**2
            course = MotorCourse(angle, before + acceleration * t, np.full(len(t), acceleration))
            self.plant.run(t, course, np.full(len(t), 25.0))


def _objects() -> dict[tuple[int, int], list[int]]:
    """(index, sub) -> [value, bytes, signed]."""
    table: dict[tuple[int, int], list[int]] = {
        (0x1016, 0): [1, 1, 0], (0x1016, 1): [0, 4, 0],
        (0x6007, 0): [0, 2, 1], (0x6040, 0): [0, 2, 0], (0x6041, 0): [0, 2, 0], (0x605A, 0): [2, 2, 1],
        (0x6060, 0): [0, 1, 1], (0x6061, 0): [0, 1, 1], (0x6064, 0): [0, 4, 1], (0x606C, 0): [0, 4, 1],
        (0x6077, 0): [0, 2, 1], (0x607A, 0): [0, 4, 1], (0x60FF, 0): [0, 4, 1],
        (0x60B0, 0): [0, 4, 1], (0x60B1, 0): [0, 4, 1], (0x60B2, 0): [0, 2, 1],
        (0x60C2, 1): [1, 1, 0], (0x60C2, 2): [-3, 1, 1],
    }  # fmt: skip
    for index in (0x1400, 0x1401, 0x1800, 0x1801):
        table |= {(index, 1): [1 << 31, 4, 0], (index, 2): [255, 1, 0], (index + 0x200, 0): [0, 1, 0]}
        table |= {(index + 0x200, sub): [0, 4, 0] for sub in range(1, 9)}
    return table


@dataclass(slots=True)
class Cia402Face:
    """The drive. Feed it frames and time; `motor` is what really moves."""

    node: int
    counts_per_turn: float
    rated_torque_Nm: float
    motor: Motor = field(default_factory=Motor)
    quick_stop_rad_s2: float = 2000.0
    following_window_rad: float = 1.0
    """a larger following error is a fault"""
    refuses: frozenset[int] = frozenset()
    """object indices that this drive does not have"""
    mute: bool = False
    """process data no longer leaves"""
    frozen: bool = False
    """the encoder repeats its last value"""
    gain: float = 1.0
    """a wrong scale inside the drive: every target means this much more"""
    state: str = "switch on disabled"
    error_code: int = 0
    operational: bool = False
    _time_s: float | None = None
    _objects: dict[tuple[int, int], list[int]] = field(default_factory=_objects)
    _pending: dict[int, bytes] = field(default_factory=dict)
    _reference: tuple[float, float] = (0.0, 0.0)
    _aim: tuple[float, float] = (0.0, 0.0)
    """target position and the time [s] left to reach it"""
    _master_s: float | None = None
    _seen: tuple[int, int] = (0, 0)

    def stop_time_s(self, speed_rad_s: float) -> float:
        """Within this time [s] of a quick stop from this speed it stands: the ramp, and ten time constants of the
        position loop."""
        return abs(speed_rad_s) / self.quick_stop_rad_s2 + 10 / LOOP_RAD_S

    def trip(self, code: int = LOST_ENCODER) -> list[DriveFrame]:
        """A fault inside the drive: it stops by itself and says so."""
        self.error_code = code
        if self.state in ("operation enabled", "quick stop active"):
            self.state = "fault reaction active"
        elif self.state != "fault reaction active":
            self.state = "fault"
        return [(0x80 + self.node, struct.pack("<HB5x", code, 1))]

    def step(self, now_s: float) -> list[DriveFrame]:
        """Let time pass up to `now_s`; the frames that the drive sends by itself."""
        if self._time_s is None:
            self._time_s = now_s
        out: list[DriveFrame] = []
        while self._time_s + STEP_S <= now_s + 1e-9:
            self._time_s += STEP_S
            out += self._supervise()
            self._follow()
        return out

    def frame(self, identifier: int, data: bytes, now_s: float) -> list[DriveFrame]:
        """Take one frame; the answers."""
        out = self.step(now_s)
        if identifier == 0 and data[1] in (0, self.node):
            self.operational = {1: True, 2: False, 128: False, 129: False, 130: False}.get(data[0], self.operational)
        elif identifier == 0x600 + self.node:
            out.append((0x580 + self.node, self._sdo(data)))
        elif identifier == 0x80 and self.operational:
            out += self._sync()
        elif identifier == 0x700 + (self._objects[0x1016, 1][0] >> 16):
            self._master_s = now_s
        elif self.operational:
            for number in (0x1400, 0x1401):
                if self._objects[number, 1][0] & ~(1 << 30) == identifier:
                    self._pending[number] = data
        return out

    # ---- the drive's own life

    def _supervise(self) -> list[DriveFrame]:
        timeout_s = (self._objects[0x1016, 1][0] & 0xFFFF) * 1e-3
        now_s = self._time_s or 0.0
        out: list[DriveFrame] = []
        if timeout_s and self._master_s is not None and now_s - self._master_s > timeout_s:
            self._master_s = None
            self.operational = False
            out.append((0x80 + self.node, struct.pack("<HB5x", LOST_MASTER, 0x11)))
            if self.state == "operation enabled" and self._objects[0x6007, 0][0] == 3:
                self.state = "quick stop active"
        gap = abs(self._reference[0] - self.motor.position_rad)
        if self.state == "operation enabled" and gap > self.following_window_rad:
            out += self.trip(FOLLOWING)
        return out

    def _follow(self) -> None:
        position, speed = self._reference
        if self.state == "operation enabled":
            position, speed = self._interpolated()
        elif self.state in ("quick stop active", "fault reaction active"):
            slowed = max(0.0, abs(speed) - self.quick_stop_rad_s2 * STEP_S)
            speed = slowed if speed > 0 else -slowed
            position += speed * STEP_S
        else:
            position, speed = self.motor.position_rad, self.motor.velocity_rad_s
        self._reference = (position, speed)
        powered = self.state in ("operation enabled", "quick stop active", "fault reaction active")
        self.motor.step(position, speed, powered=powered)
        if powered and self.state != "operation enabled" and abs(self.motor.velocity_rad_s) < STANDING_RAD_S:
            self._stopped()

    def _stopped(self) -> None:
        if self.state == "fault reaction active":
            self.state = "fault"
        elif self._objects[0x605A, 0][0] < QUICK_STOP_OPTION_STAY:
            self.state = "switch on disabled"

    def _interpolated(self) -> tuple[float, float]:
        scale = TURN_RAD / self.counts_per_turn
        if self._objects[0x6060, 0][0] == 9:
            speed = (self._objects[0x60FF, 0][0] + self._objects[0x60B1, 0][0]) * scale * self.gain
            return self._reference[0] + speed * STEP_S, speed
        target, left_s = self._aim
        if left_s < STEP_S / 2:
            return target, 0.0
        speed = (target - self._reference[0]) / left_s
        self._aim = (target, left_s - STEP_S)
        return self._reference[0] + speed * STEP_S, speed

    # ---- process data

    def _sync(self) -> list[DriveFrame]:
        for number, data in self._pending.items():
            self._scatter(number + 0x200, data)
        self._pending.clear()
        if self.state == "operation enabled" and self._objects[0x6060, 0][0] == 8:
            cycle_s = self._objects[0x60C2, 1][0] * 10.0 ** self._objects[0x60C2, 2][0]
            target = self._objects[0x607A, 0][0] + self._objects[0x60B0, 0][0]
            self._aim = (target * TURN_RAD / self.counts_per_turn * self.gain, cycle_s)
        self._latch()
        if self.mute:
            return []
        enabled = [n for n in (0x1800, 0x1801) if not self._objects[n, 1][0] & 1 << 31]
        return [(self._objects[n, 1][0] & 0x7FF, self._gathered(n + 0x200)) for n in enabled]

    def _latch(self) -> None:
        scale = self.counts_per_turn / TURN_RAD
        if not self.frozen:
            self._seen = (round(self.motor.position_rad * scale), round(self.motor.velocity_rad_s * scale))
        self._objects[0x6041, 0][0] = STATUS[self.state]
        self._objects[0x6064, 0][0], self._objects[0x606C, 0][0] = self._seen
        self._objects[0x6077, 0][0] = round(1000 * self.motor.torque_Nm / self.rated_torque_Nm)

    def _mapped(self, mapping: int) -> list[list[int]]:
        count = self._objects[mapping, 0][0]
        entries = [self._objects[mapping, sub][0] for sub in range(1, count + 1)]
        return [self._objects[entry >> 16, entry >> 8 & 0xFF] for entry in entries]

    def _gathered(self, mapping: int) -> bytes:
        return b"".join(_packed(row) for row in self._mapped(mapping))

    def _scatter(self, mapping: int, data: bytes) -> None:
        at = 0
        for row in self._mapped(mapping):
            row[0] = _unpacked(row, data[at : at + row[1]])
            at += row[1]
        self._control(self._objects[0x6040, 0][0])

    def _control(self, word: int) -> None:
        """CiA 402-2, commands of the controlword; a command that the state does not know changes nothing."""
        state = self.state
        if state == "fault":
            self.state = "switch on disabled" if word & 0x80 else state
        elif state == "fault reaction active":
            return
        elif word & 0x82 == 0:
            self.state = "switch on disabled"
        elif word & 0x86 == 0x02:
            self.state = "quick stop active" if state == "operation enabled" else state
            self.state = "switch on disabled" if state in ("ready to switch on", "switched on") else self.state
        elif state == "quick stop active":
            return
        elif word & 0x87 == 0x06:
            self.state = "ready to switch on"
        elif word & 0x8F == 0x07 and state in ("ready to switch on", "operation enabled"):
            self.state = "switched on"
        elif word & 0x8F == 0x0F and state == "switched on":
            self.state = "operation enabled"
            self._reference = (self.motor.position_rad, 0.0)
            self._aim = (self.motor.position_rad, 0.0)

    # ---- service data

    def _sdo(self, data: bytes) -> bytes:
        command, index, sub = struct.unpack_from("<BHB", data)
        row = self._objects.get((index, sub))
        if row is None or index in self.refuses:
            return struct.pack("<BHBI", 0x80, index, sub, NOT_FOUND)
        if command >> 5 == 2:
            self._latch()
            size = row[1]
            return struct.pack("<BHB", 0x43 | (4 - size) << 2, index, sub) + _packed(row).ljust(4, b"\0")
        if index in (0x6041, 0x6064, 0x606C, 0x6077):
            return struct.pack("<BHBI", 0x80, index, sub, READ_ONLY)
        row[0] = _unpacked(row, data[4 : 4 + row[1]])
        if index == 0x1016:
            self._master_s = None  # watching begins with the first heartbeat heard
        return struct.pack("<BHB4x", 0x60, index, sub)


def _packed(row: list[int]) -> bytes:
    value, size, signed = row
    return value.to_bytes(size, "little", signed=bool(signed))


def _unpacked(row: list[int], data: bytes) -> int:
    return int.from_bytes(data, "little", signed=bool(row[2]))


def serve(bus: Any, face: Cia402Face, stop: threading.Event, now: Callable[[], float]) -> None:
    """Play the drive on a python-can bus in real time until `stop`; meant for a thread."""
    import can

    def send(frames: list[DriveFrame]) -> None:
        for identifier, data in frames:
            bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    while not stop.is_set():
        message = bus.recv(STEP_S)
        send(face.step(now()))
        while message is not None:
            send(face.frame(message.arbitration_id, bytes(message.data), now()))
            message = bus.recv(0)

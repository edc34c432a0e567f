"""A drive on a bench whose time is a variable: canopen on one side, the rig's drive on the other, no threads."""

from __future__ import annotations

from typing import Any

import can
import canopen

from edge_daemon.clock import Clock
from edge_daemon.config.settings import Drive, Excite, ExciteLimits, Profile
from edge_daemon.excite.arming import Armed, DeadMan, arm
from edge_daemon.excite.drive_link import CanopenDrive
from edge_daemon.excite.profiles import PlannedMotion, planned_motion
from edge_daemon.excite.runner import Runner
from edge_daemon.records import Readings
from edge_daemon.servo.cia402_face import Cia402Face

COUNTS = 65_536.0
NODE = 3


def limits(**changes: Any) -> ExciteLimits:
    base: dict[str, Any] = {
        "travel_rad": 10.0,
        "speed_rad_s": 100.0,
        "acceleration_rad_s2": 4000.0,
        "torque_Nm": 1.0,
        "inertia_kg_m2": 1e-4,
        "following_error_rad": 0.4,
    }
    return ExciteLimits(**(base | changes))


def loose() -> ExciteLimits:
    """For real time on a busy machine, whose late SYNCs jerk the motor: only the interlock in question may act."""
    return limits(following_error_rad=20.0, speed_rad_s=1e3, acceleration_rad_s2=1e6, torque_Nm=1e3, travel_rad=1e3)


def excite(limit: ExciteLimits | None = None, **changes: Any) -> Excite:
    base: dict[str, Any] = {
        "allowed": True,
        "source": "can0",
        "node": NODE,
        "counts_per_turn": COUNTS,
        "rated_torque_Nm": 0.64,
        "limits": limit or limits(),
    }
    return Excite(**(base | changes))


def armed(settings: Excite) -> Armed:
    drive = Drive(name="axis-1", modbus_device_id=1, model="m", channels=(), excite=settings)
    return arm(drive, "axis-1")


def sine(seconds: float = 0.6, speed: float = 40.0, frequency_hz: float = 4.0) -> Profile:
    return Profile(name="s", kind="sine", speed_rad_s=speed, seconds=seconds, frequency_hz=(frequency_hz,), fade_s=0.3)


class Bus:
    """What canopen sends reaches the drive at once; the drive's answers come back before `send` returns."""

    channel_info = "bench"

    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def send(self, message: can.Message) -> None:
        if self.bench.cut:
            raise can.CanOperationError("Network is down")
        face, now_s = self.bench.face, self.bench.now_s
        if not self.bench.deaf:
            self.bench.deliver(face.frame(message.arbitration_id, bytes(message.data), now_s))


class Bench:
    """Time, bus and drive. `at` schedules what goes wrong and when."""

    def __init__(self, settings: Excite) -> None:
        self.settings = settings
        self.now_s = 100.0
        self.wall_ahead_s = 0.0
        self.cut = False
        self.deaf = False
        self.face = Cia402Face(NODE, COUNTS, settings.rated_torque_Nm)
        self.network = canopen.Network(Bus(self))  # type: ignore[arg-type]
        self.dead_man = DeadMan(settings.dead_man_s, lambda: self.now_s)
        self.operator = True
        self.temperature = 30.0
        self.marks: list[Readings] = []
        self.plan: list[tuple[float, Any]] = []
        self.fastest = 0.0
        self.began_s = self.now_s
        self.each_ms: Any = None

    def deliver(self, frames: list[tuple[int, bytes]]) -> None:
        for identifier, data in frames:
            self.network.notify(identifier, bytearray(data), self.now_s)

    def at(self, after_s: float, action: Any) -> None:
        self.plan.append((self.began_s + after_s, action))

    def wait(self, seconds: float) -> None:
        """Time passes; the operator breathes; what is planned happens."""
        end_s = self.now_s + max(0.0, seconds)
        while self.now_s < end_s - 1e-9:
            step = min(1e-3, end_s - self.now_s)
            self.now_s += step
            if self.operator:
                self.dead_man.give()
            for row in [row for row in self.plan if row[0] <= self.now_s]:
                self.plan.remove(row)
                row[1](self)
            self.deliver(self.face.step(self.now_s))
            if self.each_ms:
                self.each_ms(self)
            self.fastest = max(self.fastest, abs(self.face.motor.velocity_rad_s))

    def runner(self, **more: Any) -> Runner:
        return Runner(
            armed=armed(self.settings),
            link=CanopenDrive(self.network, self.settings, lambda: self.now_s),
            dead_man=self.dead_man,
            clock=Clock(lambda: self.wall_s, lambda: self.now_s),
            now=lambda: self.now_s,
            wait=self.wait,
            temperature_degC=lambda: self.temperature,
            mark=self.marks.append,
            **more,
        )

    def course(self, profile: Profile | None = None) -> PlannedMotion:
        return planned_motion(profile or sine(), self.settings.cycle_s)

    @property
    def wall_s(self) -> float:
        """The wall clock; small enough that a millisecond is a millisecond."""
        return 1000.0 + self.now_s + self.wall_ahead_s

    @property
    def speed(self) -> float:
        """How fast the motor really turns."""
        return abs(self.face.motor.velocity_rad_s)

"""`python -m edge_daemon.servo.drive`: a servo drive with its gear on a serial-line CAN adapter, to be commanded.

Node 3 is the drive (CiA 402), nodes 1 and 2 are absolute encoders on motor and output (CiA 406), node 4 is a torque
flange between gear and load, an arm in the field of gravity. The sensors answer SYNC with their mean since the last
one, as converters that oversample do: single values would fold the jerks of the targets into what is measured.
Prints one JSON line when it can be reached, and ends with its standard input.

Time here is counted in SYNCs: each lets one cycle pass. So a slow or busy machine makes the motion slower, and never
another one. Only while SYNC stays away does time follow the wall clock, and a drive that misses its master stops.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from edge_daemon.records import Array
from edge_daemon.rig.can_face import SlcanPort
from edge_daemon.rig.motion import MotorCourse, custom
from edge_daemon.rig.plant import Influence, Joint, Plant
from edge_daemon.rig.truths import ROWS, TRUTHS, scale_of
from edge_daemon.servo.cia402_face import STEP_S, TURN_RAD, Cia402Face, DriveFrame, Motor

ENCODER_IN, ENCODER_OUT, DRIVE, FLANGE = 1, 2, 3, 4
"""These are the nodes on the bus."""
JOINT = Joint(inertia_kg_m2=1.2, stiffness_Nm_per_rad=2.0e4, damping_Nms_per_rad=15.0, ratio=100.0)
"""A gear of size 32 under an arm of 30 kg, 0.2 m off the axis."""
ARM_Nm = 30.0 * 9.81 * 0.2
KINEMATIC_ERROR_RAD = 5e-5
"""The error repeats twice a motor turn, 10 arc-seconds."""
COUNTS_IN, COUNTS_OUT = 2**20, 2**24
ENCODER_NOISE_STEPS = 0.3
RATED_FLANGE_Nm = 40.0
FLANGE_NOISE_Nm = 0.02
DRIVE_COUNTS = 65_536.0
DRIVE_RATED_Nm = 0.64
SYNC = 0x080
SYNC_MISSED_S = 2.0
"""By the wall clock, a longer silence is no busy machine but a lost master (guess)."""
LOOK_EVERY_S = 0.05


@dataclass(slots=True)
class AnsweringPort(SlcanPort):
    """The adapter, which also hands over what its host sends."""

    heard: list[DriveFrame] = field(default_factory=list)

    def _obey(self, command: bytes) -> None:
        if command[:1] != b"t":
            SlcanPort._obey(self, command)
            return
        length = int(command[4:5], 16)
        self.heard.append((int(command[1:4], 16), bytes.fromhex(command[5 : 5 + 2 * length].decode())))

    @property
    def descriptor(self) -> int:
        """To wait on."""
        return self._master


USUAL_TONES_HZ = (1.3, 3.7, 7.9, 12.7)
"""An effect's size is drawn for a motion of these tones, the shaking of the shipped configuration."""
USUAL_SPEED_RAD_S = 25.0
"""Each of them has this motor speed, so that their sum stays below the 100 rad/s of that configuration."""


def hidden(name: str, seed: int) -> Influence:
    """An effect of the gear, its size drawn from the seed."""
    motion = custom(USUAL_TONES_HZ, [USUAL_SPEED_RAD_S] * len(USUAL_TONES_HZ))
    row = TRUTHS[name]
    return row.build(row.draw(np.random.default_rng(seed), scale_of(JOINT, motion, 10.0, 1.0), JOINT), JOINT)


def can_hide() -> list[str]:
    """Effects that the gear can have beside its kinematic error: laws of the twist, which the flange feels too."""
    laws = {row.name: hidden(row.name, 0) for row in ROWS}
    return [name for name, law in laws.items() if law.twist and not law.load]


def gear(laws: Sequence[Influence] = ()) -> Plant:
    """The joint with its kinematic error, the arm's weight, and what else it is to have."""

    def wave(motor: MotorCourse) -> MotorCourse:
        sine, cosine = np.sin(2 * motor.angle), np.cos(2 * motor.angle)
        speed = 2 * motor.speed
        return MotorCourse(
            KINEMATIC_ERROR_RAD * sine,
            KINEMATIC_ERROR_RAD * cosine * speed,
            KINEMATIC_ERROR_RAD * (2 * motor.acceleration * cosine - speed**2 * sine),
        )

    def weight(_time_s: Array, theta_in_rad: Array) -> Array:
        return -ARM_Nm * np.sin(theta_in_rad / JOINT.ratio)

    return Plant(JOINT, (Influence(angle=wave), Influence(torque=weight), *laws))


def carried_Nm(plant: Plant) -> float:
    """Torque of the gear on its output: what the flange feels."""
    phi, dphi = plant.phi_rad, plant.dphi_rad_s
    rows = ((row.twist, plant.remembered(row)) for row in plant.influences)
    laws = sum(law.at(z, plant.step_s, phi, dphi, 0.0, 0.0)[0] for law, z in rows if law)
    return JOINT.stiffness_Nm_per_rad * phi + JOINT.damping_Nms_per_rad * dphi + laws


@dataclass(slots=True)
class Servo:
    """The drive, its gear and its sensors. `cycle_s`: what one SYNC lets pass."""

    cycle_s: float
    seed: int = 1
    effect: str = ""
    """one of `can_hide()`; empty: the plain gear"""
    time_s: float = 0.0
    face: Cia402Face = field(init=False)
    plant: Plant = field(init=False)
    _rng: np.random.Generator = field(init=False)
    _sums: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    _steps: int = 0

    def __post_init__(self) -> None:
        self.plant = gear([hidden(self.effect, self.seed)] if self.effect else [])
        self._rng = np.random.default_rng(self.seed)
        motor = Motor(torque_limit_Nm=2.0, plant=self.plant)
        self.face = Cia402Face(DRIVE, DRIVE_COUNTS, DRIVE_RATED_Nm, motor=motor, following_window_rad=5.0)
        self.face.step(0.0)

    def take(self, identifier: int, data: bytes) -> list[DriveFrame]:
        """What everybody on the bus answers to one frame."""
        if identifier != SYNC:
            return self.face.frame(identifier, data, self.time_s)
        self.pass_time(self.cycle_s)
        return [*self.face.frame(SYNC, data, self.time_s), *self._sensors()]

    def pass_time(self, seconds: float) -> list[DriveFrame]:
        """Lets time pass; what the drive says by itself."""
        end_s, frames = self.time_s + seconds, list[DriveFrame]()
        while self.time_s < end_s - STEP_S / 2:
            self.time_s += STEP_S
            motor = self.face.motor
            motor.load_Nm = carried_Nm(self.plant) / JOINT.ratio
            frames += self.face.step(self.time_s)
            for i, value in enumerate((motor.position_rad, motor.theta_out_rad, carried_Nm(self.plant))):
                self._sums[i] += value
            self._steps += 1
        return frames

    def _sensors(self) -> list[DriveFrame]:
        """Means since the last SYNC. The flange answers last: with its frame a cycle is complete."""
        theta_in, theta_out, torque = (total / max(1, self._steps) for total in self._sums)
        self._sums, self._steps = [0.0, 0.0, 0.0], 0
        noise = self._rng.normal(0.0, 1.0, 3).tolist()
        frames = []
        for node, angle, counts, error in (
            (ENCODER_IN, theta_in, COUNTS_IN, noise[0]),
            (ENCODER_OUT, theta_out, COUNTS_OUT, noise[1]),
        ):
            value = round(angle / TURN_RAD * counts + ENCODER_NOISE_STEPS * error)
            frames.append((0x180 + node, (value & 0xFFFF_FFFF).to_bytes(4, "little")))
        mille = round(1000 * (torque + FLANGE_NOISE_Nm * noise[2]) / RATED_FLANGE_Nm)
        mille = max(-32_768, min(32_767, mille))
        return [*frames, (0x180 + FLANGE, mille.to_bytes(2, "little", signed=True))]


def truth() -> dict[str, float]:
    """What is true of the gear."""
    return {
        "stiffness_Nm_per_rad": JOINT.stiffness_Nm_per_rad,
        "damping_Nms_per_rad": JOINT.damping_Nms_per_rad,
        "inertia_kg_m2": JOINT.inertia_kg_m2,
        "ratio": JOINT.ratio,
    }


def serve(servo: Servo, port: AnsweringPort, control: int) -> None:
    """Plays the drive until the descriptor `control` ends."""
    heard_s = before_s = time.monotonic()
    while True:
        readable = select.select([control, port.descriptor], [], [], LOOK_EVERY_S)[0]
        if control in readable and not os.read(control, 4096):
            return
        port.poll()
        now_s = time.monotonic()
        if port.heard:
            heard_s = now_s
        for identifier, data in port.heard:
            port.send(servo.take(identifier, data))
        port.heard.clear()
        if now_s - heard_s > SYNC_MISSED_S:
            port.send(servo.pass_time(min(now_s - before_s, LOOK_EVERY_S)))  # behind the wall clock where it is busy
        before_s = now_s


def main() -> int:
    """Until standard input ends."""
    parser = argparse.ArgumentParser(prog="edge_daemon.servo.drive", description="A simulated drive to be commanded.")
    parser.add_argument("--cycle", type=float, required=True, help="of SYNC [s]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effect", choices=can_hide(), default="")
    given = parser.parse_args()
    if not (math.isfinite(given.cycle) and given.cycle > 0):
        parser.error("--cycle: expected above 0")
    with tempfile.TemporaryDirectory(prefix="edge-daemon-servo-") as folder:
        port = AnsweringPort(Path(folder) / "can0")
        try:
            place = {"interface": "slcan", "channel": str(port.path)}
            print(json.dumps({"ready": True, "can": place, "truth": truth()}), flush=True)
            serve(Servo(given.cycle, given.seed, given.effect), port, sys.stdin.fileno())
        finally:
            port.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())

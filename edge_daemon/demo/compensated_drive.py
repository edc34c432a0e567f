"""`compensate --demo`: one motion without offsets, with a maker's values, with a fitted model; judged by the output.

Everything goes over a CAN bus as CiA 402 has it. The judge is an output encoder that neither fit nor offsets have seen
in the motion that is judged.
"""

from __future__ import annotations

import argparse
import itertools
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import can
import numpy as np

from edge_daemon.compensate.feedforward import Feedforward, Offsets, Trajectory, feedforward
from edge_daemon.compensate.gate import gated
from edge_daemon.compensate.shaper import resonance, shaped
from edge_daemon.compensate.stream import DriveScale, OffsetBounds, OffsetStream
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.identify.fit import fit
from edge_daemon.records import Array
from edge_daemon.servo.drive import (
    COUNTS_IN,
    COUNTS_OUT,
    DRIVE,
    DRIVE_COUNTS,
    JOINT,
    ARM_Nm,
    DRIVE_RATED_Nm,
    Servo,
)
from edge_daemon.text import number, progress, table, written_as_json
from edge_daemon.usage.gears import find_gear

CYCLE_S = 0.005
RATE_HZ = 1.0 / CYCLE_S
TURN = 2.0 * math.pi
JUDGE_COUNTS = 2**20
"""The judge's encoder has 20 bits."""
BOUNDS = OffsetBounds(position_rad=0.6, velocity_rad_s=50.0, torque_Nm=1.0, fade_s=0.5)
FADED_IN_S = 2.0
"""The first two seconds of a motion are not judged: offsets fade in."""
REST_S = 0.5
"""Ringing is looked at so long after a move has ended: ten periods of the arm on its gear."""
MOVE_RAD, MOVE_S = 0.02, 0.04
GEAR = "CSG-20-100"
MAPPED = {0x1400: (0x200, (0x60400010, 0x607A0020)), 0x1401: (0x300, (0x60B00020, 0x60B10020, 0x60B20010))}
"""What the drive's receive PDOs carry: control word and target position; the three offsets."""
_BUSES = itertools.count(1)
BothAngles = tuple[Array, Array]
"""Motor and output (n,) [rad]."""


class DriveLine:
    """A master and the simulated drive on one virtual CAN bus, cycle by cycle."""

    def __init__(self, channel: str) -> None:
        self.master = can.Bus(interface="virtual", channel=channel)
        self.slave = can.Bus(interface="virtual", channel=channel)
        self.servo = Servo(CYCLE_S)
        for index, (identifier, mapped) in MAPPED.items():
            for sub, entry in enumerate(mapped, 1):
                self._write(index + 0x200, sub, entry, 4)
            self._write(index + 0x200, 0, len(mapped), 1)
            self._write(index, 1, identifier + DRIVE, 4)
        self._write(0x6060, 0, 8, 1)
        self._write(0x60C2, 1, round(CYCLE_S * 1e3), 1)
        self._talk(0, bytes([1, DRIVE]))
        for word in (0x06, 0x07, 0x0F):
            self.cycle(0.0, bytes(10), word)

    def close(self) -> None:
        self.master.shutdown()
        self.slave.shutdown()

    def _talk(self, identifier: int, data: bytes) -> dict[int, bytes]:
        self.master.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))
        while (heard := self.slave.recv(0)) is not None:
            for answer, content in self.servo.take(heard.arbitration_id, bytes(heard.data)):
                self.slave.send(can.Message(arbitration_id=answer, data=content, is_extended_id=False))
        answers = {}
        while (heard := self.master.recv(0)) is not None:
            answers[heard.arbitration_id] = bytes(heard.data)
        return answers

    def _write(self, index: int, sub: int, value: int, size: int) -> None:
        data = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
        if self._talk(0x600 + DRIVE, data)[0x580 + DRIVE][0] != 0x60:
            raise BadInput(f"the simulated drive refuses object {index:#x}")

    def cycle(self, target_rad: float, offset: bytes, word: int = 0x0F) -> tuple[float, float]:
        """One SYNC: motor and output angle as the encoders say [rad], the output's at 20 bits."""
        counts = round(target_rad / TURN * DRIVE_COUNTS)
        self._talk(0x200 + DRIVE, struct.pack("<Hi", word, counts))
        self._talk(0x300 + DRIVE, offset)
        answers = self._talk(0x80, b"")
        seen = (int.from_bytes(answers[0x180 + k], "little", signed=True) for k in (1, 2))
        motor, output = (value / counts * TURN for value, counts in zip(seen, (COUNTS_IN, COUNTS_OUT), strict=True))
        return motor, round(output / TURN * JUDGE_COUNTS) / JUDGE_COUNTS * TURN


def moved(target: Array, offsets: Offsets | None, valid: Callable[[int], bool] = lambda _: True) -> BothAngles:
    """What the encoders say over a motion in which the output is to follow `target` (n,) [rad]."""
    stream = OffsetStream(BOUNDS, DriveScale(DRIVE_COUNTS / TURN, DRIVE_RATED_Nm))
    nothing = np.zeros(len(target))
    given = offsets or Offsets(nothing, nothing, nothing, {})
    line = DriveLine(f"compensated-{next(_BUSES)}")
    seen = []
    try:
        for k, angle in enumerate(JOINT.ratio * target):
            wanted = float(given.position_rad[k]), float(given.velocity_rad_s[k]), float(given.torque_Nm[k])
            sent = stream.step(*wanted, valid=offsets is not None and valid(k), passed_s=CYCLE_S)
            seen.append(line.cycle(float(angle), sent))
    finally:
        line.close()
    motor, output = np.array(seen).T
    return motor, output


def path_of(target: Array) -> Trajectory:
    """The rates of a motion of the output (n,) [rad]."""
    speed = np.gradient(target, CYCLE_S)
    return Trajectory(RATE_HZ, target, speed, np.gradient(speed, CYCLE_S))


def slow_turns(seconds: float = 12.0) -> Array:
    """Smooth to and fro, many turns of the motor, too slow to shake the arm (n,) [rad]."""
    time = np.arange(0, seconds, CYCLE_S)
    return np.asarray(0.25 * (1 - np.cos(TURN * time / 8.0)) * np.minimum(1.0, time))


def shaken(seconds: float = 10.0) -> Array:
    """Tones below the resonance on a slow turn, from which a gear can be fitted (n,) [rad]."""
    time = np.arange(0, seconds, CYCLE_S)
    tones = sum(0.25 / (TURN * hz) * np.sin(TURN * hz * time + k) for k, hz in enumerate((1.3, 3.7, 7.9, 12.7)))
    return np.asarray((tones + 0.35 * (1 - np.cos(TURN * time / seconds))) * np.minimum(1.0, time))


def one_move() -> Array:
    """Fast enough to ring (n,) [rad]."""
    time = np.arange(0, 2.0, CYCLE_S)
    return np.asarray(MOVE_RAD * np.clip((time - 0.5) / MOVE_S, 0.0, 1.0))


class MovedRecording(NamedTuple):
    """Stands for a recording."""

    time_s: Array
    columns: Mapping[str, Array]


def fitted() -> Model:
    """What a fit makes of ten seconds of the drive's own motion."""
    motor, output = moved(shaken(), None)
    names = ("linear_stiffness", "viscous_damping", "kinematic_error", "gravity_load")
    empty = Model("torsion", JOINT.ratio, JOINT.inertia_kg_m2, tuple(map(ModelEffect, names)))
    columns = {"theta_in_rad": motor, "theta_out_rad": output}
    return fit([MovedRecording(np.arange(len(motor)) / RATE_HZ, columns)], empty).model


def makers(known: Model) -> Model:
    """The same arm on a gear of which the maker's catalogue is all that is known: one stiffness, no error."""
    stiffness = find_gear(GEAR).stiffness_2_Nm_per_rad or math.nan
    row = ModelEffect("linear_stiffness", {"stiffness": FittedParameter(stiffness, 0.0, "N m/rad", True)})
    arm = {"sine": FittedParameter(ARM_Nm, 0.0, "N m", True), "cosine": FittedParameter(0.0, 0.0, "N m", True)}
    return known.without("kinematic_error").with_effect(row).with_effect(ModelEffect("gravity_load", arm))


def mistaken(known: Model) -> Model:
    """The same with a third of the stiffness: what must never make the output worse."""
    row = known.effect("linear_stiffness")
    assert row is not None
    stiffness = row.parameters["stiffness"]
    wrong = replace(stiffness, value=0.3 * stiffness.value)
    return known.with_effect(ModelEffect("linear_stiffness", {"stiffness": wrong}))


def output_error_rad(target: Array, output: Array) -> float:
    """Root mean square of output less target, without a constant and a delay of the whole drive."""
    first = round(FADED_IN_S / CYCLE_S)
    wrong = (output - target)[first:]
    columns = np.column_stack([np.ones(len(wrong)), np.gradient(target, CYCLE_S)[first:]])
    return float(np.sqrt(np.mean((wrong - columns @ np.linalg.lstsq(columns, wrong, rcond=None)[0]) ** 2)))


def ringing_rad(target: Array) -> float:
    """Swing of the output after a move has ended, peak to peak."""
    output = moved(target, None)[1]
    end = int(np.flatnonzero(np.diff(target)).max()) + 2
    return float(np.ptp(output[end : end + round(REST_S / CYCLE_S)]))


def measured() -> dict[str, dict[str, float]]:
    """Output error [rad] by what was commanded, and ringing [rad] of a plain and a shaped move."""
    say = progress("compensate")
    say("the motion that is fitted", 0.0)
    known, target, move = fitted(), slow_turns(), one_move()
    say("the motion that is judged", 0.2)
    plain = moved(target, None)
    error = {"without": output_error_rad(target, plain[1])}
    ready: dict[str, Feedforward] = {
        "maker's values": feedforward(makers(known)),
        "a wrong model, gated": gated(feedforward(mistaken(known)), RATE_HZ, *plain, None),
        "fitted model": feedforward(known),
    }
    for done, (name, one) in enumerate(ready.items(), 2):
        say(name, done / 6)
        error[name] = output_error_rad(target, moved(target, one.offsets(path_of(target)))[1])
    say("a move that rings", 5 / 6)
    ringing = {"plain": ringing_rad(move), "shaped": ringing_rad(shaped(move, RATE_HZ, resonance(known)))}
    say("done", 1.0)
    return {"output_error_rad": error, "ringing_rad": ringing}


def demonstrate(arguments: argparse.Namespace) -> None:
    """Prints how much of the output's error each model takes away."""
    found = measured()
    if written_as_json(found, arguments.json):
        return
    error, ringing = found["output_error_rad"], found["ringing_rad"]
    rows = [
        [name, number(1e6 * value, 3), number(error["without"] / value, 3)]  # urad
        for name, value in error.items()
    ]
    plain, calmed = (number(1e3 * ringing[name], 2) for name in ("plain", "shaped"))
    print("Output error of the simulated drive over one motion, over CAN (CiA 402), seen by an encoder of 20 bits:\n")
    print(table(["offsets", "rms urad", "times less"], rows))
    print(f"\nA move of {MOVE_RAD:g} rad in {MOVE_S:g} s rings by {plain} mrad, through the shaper by {calmed} mrad.")
    print("For a drive of yours: edge-daemon compensate --model M --recording REC --trajectory T.csv --stream F.csv")

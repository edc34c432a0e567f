"""Offsets on the simulated drive, over a CAN bus as CiA 402 has them; judged by an encoder that they never see."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import can
import numpy as np
import pytest

from edge_daemon.compensate.feedforward import Feedforward, Offsets, Trajectory, feedforward
from edge_daemon.compensate.gate import gated
from edge_daemon.compensate.shaper import resonance, shaped
from edge_daemon.compensate.stream import DriveScale, OffsetBounds, OffsetStream
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.records import Array
from edge_daemon.servo.drive import (
    COUNTS_IN,
    COUNTS_OUT,
    DRIVE,
    DRIVE_COUNTS,
    JOINT,
    KINEMATIC_ERROR_RAD,
    ARM_Nm,
    DRIVE_RATED_Nm,
    Servo,
)
from edge_daemon.usage.gears import find_gear

CYCLE_S = 0.005
RATE_HZ = 1 / CYCLE_S
COUNTS_20_BITS = 2**20
TURN = 2 * math.pi
Motion = tuple[Array, Array]


class Recorded(NamedTuple):
    time_s: Array
    columns: Mapping[str, Array]


class Line:
    """A master and the simulated drive on one virtual CAN bus, cycle by cycle."""

    def __init__(self, channel: str) -> None:
        self.master = can.Bus(interface="virtual", channel=channel)
        self.slave = can.Bus(interface="virtual", channel=channel)
        self.servo = Servo(CYCLE_S)
        for index, mapped in ((0x1400, (0x60400010, 0x607A0020)), (0x1401, (0x60B00020, 0x60B10020, 0x60B20010))):
            for sub, entry in enumerate(mapped, 1):
                self._write(index + 0x200, sub, entry, 4)
            self._write(index + 0x200, 0, len(mapped), 1)
            self._write(index, 1, (0x200 if index == 0x1400 else 0x300) + DRIVE, 4)
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
        assert self._talk(0x600 + DRIVE, data)[0x580 + DRIVE][0] == 0x60, hex(index)

    def cycle(self, target_rad: float, offset: bytes, word: int = 0x0F) -> tuple[float, float]:
        """One SYNC: motor and output angle as the encoders say [rad], the output's at 20 bits."""
        counts = round(target_rad / TURN * DRIVE_COUNTS)
        self._talk(0x200 + DRIVE, struct.pack("<Hi", word, counts))
        self._talk(0x300 + DRIVE, offset)
        answers = self._talk(0x80, b"")
        seen = (int.from_bytes(answers[0x180 + k], "little", signed=True) for k in (1, 2))
        motor, output = (value / counts * TURN for value, counts in zip(seen, (COUNTS_IN, COUNTS_OUT), strict=True))
        return motor, round(output / TURN * COUNTS_20_BITS) / COUNTS_20_BITS * TURN


def run(target: Array, offsets: Offsets | None, valid: Callable[[int], bool] = lambda k: True) -> Motion:
    """Motor and output angle over a motion of the output `target` (n,) [rad]."""
    bounds = OffsetBounds(position_rad=0.6, velocity_rad_s=50.0, torque_Nm=1.0, fade_s=0.5)
    stream = OffsetStream(bounds, DriveScale(DRIVE_COUNTS / TURN, DRIVE_RATED_Nm))
    line = Line(f"drive-{id(stream)}")
    seen = []
    try:
        for k, angle in enumerate(JOINT.ratio * target):
            given = (0.0, 0.0, 0.0)
            if offsets is not None:
                given = tuple(
                    float(row[k]) for row in (offsets.position_rad, offsets.velocity_rad_s, offsets.torque_Nm)
                )
            seen.append(line.cycle(float(angle), stream.step(*given, offsets is not None and valid(k), CYCLE_S)))
    finally:
        line.close()
    motor, output = np.array(seen).T
    return motor, output


def path_of(target: Array) -> Trajectory:
    speed = np.gradient(target, CYCLE_S)
    return Trajectory(RATE_HZ, target, speed, np.gradient(speed, CYCLE_S))


def slow_turns(seconds: float = 12.0) -> Array:
    """Smooth to and fro, many turns of the motor, too slow to shake the arm."""
    time = np.arange(0, seconds, CYCLE_S)
    return 0.25 * (1 - np.cos(TURN * time / 8.0)) * np.minimum(1.0, time)


def error_rms(target: Array, output: Array, after_s: float = 2.0) -> float:
    """Output against target, less a constant and a delay of the whole drive."""
    first = round(after_s / CYCLE_S)
    wrong = (output - target)[first:]
    columns = np.column_stack([np.ones(len(wrong)), np.gradient(target, CYCLE_S)[first:]])
    return float(np.sqrt(np.mean((wrong - columns @ np.linalg.lstsq(columns, wrong, rcond=None)[0]) ** 2)))


def fitted(value: float, share: float = 0.01) -> FittedParameter:
    return FittedParameter(value, abs(value) * share + 1e-9, "1", True)


def model(
    stiffness: float = JOINT.stiffness_Nm_per_rad, wave: float = KINEMATIC_ERROR_RAD, arm: float = ARM_Nm
) -> Model:
    """As a fit writes it; the truth by default."""
    waves = {name: fitted(0.0) for name in ("sine_1", "cosine_1", "cosine_2", "sine_4", "cosine_4")}
    return Model(
        "torsion",
        JOINT.ratio,
        JOINT.inertia_kg_m2,
        (
            ModelEffect("linear_stiffness", {"stiffness": fitted(stiffness)}),
            ModelEffect("viscous_damping", {"damping": fitted(JOINT.damping_Nms_per_rad)}),
            ModelEffect("kinematic_error", {**waves, "sine_2": fitted(wave)}),
            ModelEffect("gravity_load", {"sine": fitted(arm), "cosine": fitted(0.0)}),
        ),
    )


@pytest.fixture(scope="module")
def plain() -> tuple[Array, Motion]:
    target = slow_turns()
    return target, run(target, None)


def test_the_kinematic_error_falls_to_a_tenth(plain: tuple[Array, Motion]) -> None:
    """Both runs with the twist mended, so that what is left is the transmission's."""
    target, _ = plain
    ready = feedforward(model())
    twist_only = run(target, ready.without("kinematic", "asked").offsets(path_of(target)))[1]
    both = run(target, ready.offsets(path_of(target)))[1]
    assert error_rms(target, both) < 0.1 * error_rms(target, twist_only)


def test_the_twist_falls_to_a_fifth_also_where_the_stiffness_is_ten_percent_wrong(plain: tuple[Array, Motion]) -> None:
    target, (_, output) = plain
    for stiffness in (1.0, 0.9):
        ready = feedforward(model(stiffness=stiffness * JOINT.stiffness_Nm_per_rad))
        mended = run(target, ready.offsets(path_of(target)))[1]
        assert error_rms(target, mended) < 0.2 * error_rms(target, output)


def shaken(seconds: float = 10.0) -> Array:
    """Tones below the resonance on a slow turn: what `excite` runs to fit a gear."""
    time = np.arange(0, seconds, CYCLE_S)
    tones = sum(0.25 / (TURN * hz) * np.sin(TURN * hz * time + k) for k, hz in enumerate((1.3, 3.7, 7.9, 12.7)))
    return np.asarray((tones + 0.35 * (1 - np.cos(TURN * time / seconds))) * np.minimum(1.0, time))


def test_what_a_fit_knows_is_worth_more_than_what_a_catalogue_says(plain: tuple[Array, Motion]) -> None:
    """All through the protocol: a recording of the drive, a fit of it, and another motion with what was fitted."""
    motion = shaken()
    motor, output = run(motion, None)
    columns = {"theta_in_rad": motor, "theta_out_rad": output}
    names = ("linear_stiffness", "viscous_damping", "kinematic_error", "gravity_load")
    empty = Model("torsion", JOINT.ratio, JOINT.inertia_kg_m2, tuple(map(ModelEffect, names)))
    known = fit([Recorded(CYCLE_S * np.arange(len(motion)), columns)], empty).model
    maker = find_gear("CSG-20-100").stiffness_2_Nm_per_rad
    assert maker is not None and known.value("linear_stiffness", "stiffness") == pytest.approx(2e4, rel=0.005)
    target, (_, before) = plain
    without = error_rms(target, before)
    left = {}
    for name, one in (("maker", model(stiffness=maker).without("kinematic_error")), ("fit", known)):
        ready = feedforward(one)
        left[name] = error_rms(target, run(target, ready.offsets(path_of(target)))[1])
    assert left["maker"] < 0.5 * without and left["fit"] < 0.1 * left["maker"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"wave": -KINEMATIC_ERROR_RAD},
        {"stiffness": 0.3 * JOINT.stiffness_Nm_per_rad},
        {"stiffness": 10 * JOINT.stiffness_Nm_per_rad, "wave": 20 * KINEMATIC_ERROR_RAD},
        {"arm": -ARM_Nm, "wave": 0.2 * KINEMATIC_ERROR_RAD},
    ],
)
def test_under_a_wrong_model_it_is_never_worse_than_without(
    plain: tuple[Array, Motion], wrong: dict[str, float]
) -> None:
    """The gate looks at a recording of the drive, as `compensate --recording` does."""
    target, (motor, output) = plain
    ready = gated(feedforward(model(**wrong)), RATE_HZ, motor, output, None)
    assert ready.off
    mended = run(target, ready.offsets(path_of(target)))[1]
    assert error_rms(target, mended) < 1.02 * error_rms(target, output)


def test_a_right_model_passes_the_gate(plain: tuple[Array, Motion]) -> None:
    _, (motor, output) = plain
    assert not gated(feedforward(model()), RATE_HZ, motor, output, None).off


def test_an_estimate_that_ceases_to_be_valid_fades_out_without_a_step(plain: tuple[Array, Motion]) -> None:
    target, (motor, _) = plain
    offsets = feedforward(model()).offsets(path_of(target))
    half = len(target) // 2
    moved = run(target, offsets, lambda k: k < half)[0]
    added = moved - motor
    assert np.abs(added[half + round(0.7 / CYCLE_S) :]).max() < 1e-3
    assert np.abs(np.diff(added[half - 5 :])).max() < 3e-3


def ringing(target: Array) -> float:
    """Largest swing of the output in the half second after a move has ended."""
    output = run(target, None)[1]
    end = int(np.flatnonzero(np.diff(target)).max()) + 2
    rest = output[end : end + round(0.5 / CYCLE_S)]
    return float(np.ptp(rest - np.linspace(rest[-20:].mean(), rest[-20:].mean(), len(rest))))


def test_a_shaped_move_leaves_a_tenth_of_the_ringing() -> None:
    time = np.arange(0, 2.0, CYCLE_S)
    move = 0.02 * np.clip((time - 0.5) / 0.04, 0.0, 1.0)
    found = resonance(model())
    assert ringing(shaped(move, RATE_HZ, found)) < 0.1 * ringing(move)


def test_what_is_not_identified_is_off_and_no_part_is_a_surprise() -> None:
    sure = model()
    row = sure.effect("linear_stiffness")
    assert row is not None
    unsure = sure.with_effect(replace(row, parameters={"stiffness": FittedParameter(2e4, 1e4, "N m/rad", False)}))
    ready: Feedforward = feedforward(unsure)
    assert set(ready.off) == {"twist"} and "stiffness" in ready.off["twist"]
    bare = feedforward(sure.without("kinematic_error"))
    assert set(bare.off) == {"kinematic"}
    assert not bare.offsets(path_of(slow_turns(1.0))).parts["kinematic"].any()

"""What stays in the drive and what it has done, against what the simulated drive itself knows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from edge_daemon.records import Array, Estimate, Status
from edge_daemon.rig.motion import custom
from tests.service.scenario import STEP_S, Look, scene

SECONDS = 25.0
GENTLE = custom((0.31, 1.27, 4.7, 9.1), (20.0, 30.0, 60.0, 30.0))
"""slow enough for a motor torque whose instant is known to a millisecond to tell its work"""


class Truth(NamedTuple):
    twist_loss_W: float
    motor_loss_W: float
    taken_W: float
    """work that goes in at the motor, or comes back from the output"""
    cycles_per_s: float
    turns_in: float
    rise_K: float


class Seen(NamedTuple):
    last: Look
    truth: Truth

    def of(self, name: str) -> Estimate:
        return self.last.estimates[name]


@pytest.fixture(scope="module", params=["lively", "gentle"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """The demonstration's drive for a while, and the losses that its own laws make of its own motion."""
    it = scene(tmp_path_factory.mktemp("losses"))
    if request.param == "gentle":
        it.drive.motion = GENTLE
    newest, losses = round(STEP_S / it.drive.plant.step_s), []
    for look in it.run(SECONDS):  # noqa: B007  (the last one is wanted)
        losses.append(float(np.mean(in_the_twist(it.drive.recent[2][-newest:]))))
    time_s = np.arange(0.0, SECONDS, 1e-3)
    motor = it.drive.motion.course(time_s)
    turns = float(np.abs(np.diff(motor.angle)).sum()) / (2 * math.pi)
    rise_K = it.drive.housing.temperature_degC - 25.0
    in_motor = in_the_motor(motor.speed)
    output_W = 0.05 * motor.acceleration * motor.speed / 100.0**2  # as if nothing twisted: within some per cent
    motor_W = output_W + 3e-5 * motor.acceleration * motor.speed + in_motor
    taken_W = float(np.mean(np.maximum(motor_W, 0) - np.minimum(output_W, 0)))
    cycles_per_s = passes(motor.acceleration) / SECONDS
    truth = Truth(float(np.mean(losses)), float(in_motor.mean()), taken_W, cycles_per_s, turns, rise_K)
    return Seen(look, truth)


def passes(torque: Array) -> int:
    """How often it rises from a quarter of its rms below its mean to as much above: what counts as a load cycle."""
    count, low = 0, False
    for far in ((torque - torque.mean()) / torque.std()).tolist():
        count += low and far > 0.25
        low = far < -0.25 or (low and far <= 0.25)
    return count


def in_the_twist(rate_rad_s: Array) -> Array:
    """(n,) [W] of 12 N m s/rad and 1 N m of dry friction, of the demonstration's gear."""
    return rate_rad_s * (12.0 * rate_rad_s + np.tanh(rate_rad_s / 1e-3))


def in_the_motor(speed_rad_s: Array) -> Array:
    """(n,) [W] of the simulated motor's own friction."""
    return speed_rad_s * (0.03 * np.tanh(speed_rad_s) + 2e-4 * speed_rad_s)


@pytest.mark.slow
def test_the_loop_encloses_what_the_twist_loses(seen: Seen) -> None:
    area = seen.of("hysteresis_area")
    if area.status is Status.NOT_EXCITED:  # the gentle motion hardly twists the gear, and says so
        assert seen.of("stiffness").status is Status.NOT_EXCITED
        return
    assert area.status is Status.VALID
    assert area.sd < 0.05 * area.value
    assert area.value == pytest.approx(seen.truth.twist_loss_W / seen.truth.cycles_per_s, rel=0.05, abs=4 * area.sd)


def test_the_drive_loses_what_motor_and_twist_lose(seen: Seen) -> None:
    lost = seen.of("energy_lost_per_cycle")
    true = (seen.truth.motor_loss_W + seen.truth.twist_loss_W) / seen.truth.cycles_per_s
    assert lost.status is Status.VALID
    assert lost.value == pytest.approx(true, rel=0.05, abs=4 * lost.sd)


def test_an_efficiency_is_told_where_the_motion_lets_it(seen: Seen) -> None:
    efficiency = seen.of("efficiency")
    assert (efficiency.status is Status.VALID) == (efficiency.sd <= 0.2)
    lost_W = seen.truth.motor_loss_W + seen.truth.twist_loss_W
    assert abs(efficiency.value - (1 - lost_W / seen.truth.taken_W)) < 4 * efficiency.sd


def test_turns_hours_and_warmth_are_those_of_the_drive(seen: Seen) -> None:
    turns_in, turns_out = seen.of("turns_in"), seen.of("turns_out")
    assert turns_in.value == pytest.approx(seen.truth.turns_in, rel=0.02)
    assert turns_out.value == pytest.approx(seen.truth.turns_in / 100.0, rel=0.03)
    hours = seen.of("operating_hours")
    assert abs(hours.value - SECONDS / 3600.0) < 1.0 / 3600.0
    rise, ambient = seen.of("temperature_rise"), seen.of("temperature_ambient")
    assert abs(rise.value - seen.truth.rise_K) < 4 * rise.sd + 0.02
    assert (ambient.value, ambient.unit, rise.unit) == (25.0, "degC", "K")

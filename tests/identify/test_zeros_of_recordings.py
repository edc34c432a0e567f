"""Encoders that were switched off between two recordings, or a torque sensor that was zeroed anew: their zeros come
back apart, and no law of the gear may stand in for that."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.records import Array

STIFFNESS, DAMPING, INERTIA = 3e4, 20.0, 1.2
BASE = Model("torsion", 100.0, INERTIA, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
RATE_HZ, SECONDS = 500.0, 16.0
TONES = ((0.31, 0.3), (1.1, 0.1), (2.7, 0.03), (5.3, 0.01))


@dataclass(frozen=True)
class Joint:
    """A joint by inverse dynamics: the output goes as it is told, the twist is what that takes."""

    zero_rad: float = 0.0
    load_Nm: float = 0.0
    weight_Nm: float = 0.0
    middle_rad: float = 0.0
    softer: float = 1.0
    cubic: float = 0.0
    gap_rad: float = 0.0
    error_rad: float = 0.0
    loop_Nm: float = 0.0
    sensor: bool = True
    sensor_zero_Nm: float = 0.0

    def recorded(self, seed: int) -> Recording:
        rng = np.random.default_rng(seed)
        t = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
        waves = [(size, 2 * math.pi * hz, rng.uniform(0, 6)) for hz, size in TONES]
        angle, acceleration, jerk = (
            sum(size * w**k * np.sin(w * t + phase + k * math.pi / 2) for size, w, phase in waves) for k in (0, 2, 3)
        )
        torque = INERTIA * acceleration + self.weight_Nm * np.sin(angle + self.middle_rad) + self.load_Nm
        stiffness = STIFFNESS * self.softer
        twist = (torque - DAMPING * INERTIA * jerk / stiffness) / stiffness
        twist = twist - self.cubic * (torque / stiffness) ** 3 + self.gap_rad * np.tanh(torque / 0.2)
        twist = twist - self.loop_Nm * slipping(torque, 3.0 * self.loop_Nm) / STIFFNESS
        twist = twist + self.error_rad * np.sin(2 * 100.0 * angle)
        output = angle + self.middle_rad
        columns = {
            "theta_in_rad": 100.0 * (output + twist - self.zero_rad) + rng.normal(0, 2e-6, len(t)),
            "theta_out_rad": output + rng.normal(0, 1e-7, len(t)),
        }
        if self.sensor:
            columns["torque_out_Nm"] = torque + self.sensor_zero_Nm + rng.normal(0, 0.02, len(t))
        return Recording(t, columns)


def slipping(torque_Nm: Array, after_Nm: float) -> Array:
    """(n,) in -1 to 1, of an element that slips after so much change of torque."""
    place, places = 0.0, []
    for change in np.diff(torque_Nm, prepend=torque_Nm[0]):
        place = min(max(place + change / max(after_Nm, 1e-9), -1.0), 1.0)
        places.append(place)
    return np.array(places)


@dataclass(frozen=True)
class Recording:
    time_s: Array
    columns: dict[str, Array]


@pytest.mark.parametrize("cubic", [0.0, 1e4])
def test_zeros_that_a_torque_sensor_tells_are_taken_out(cubic: float) -> None:
    """Of a straight spring to a few microradians, and of one that bends, which is not part of the model."""
    joints = [Joint(cubic=cubic), Joint(6e-4, load_Nm=22.0, cubic=cubic), Joint(-9e-4, load_Nm=40.0, cubic=cubic)]
    fitted = fit([joint.recorded(i) for i, joint in enumerate(joints)], BASE)
    found = sorted(-trial.zero_rad for trial in fitted.problem.trials)
    assert found == pytest.approx([-9e-4, 0.0, 6e-4], abs=3e-5 if cubic else 5e-6)
    line = next(line for line in fitted.problem.remarks if "zeros of the encoders differ by" in line)
    apart_rad, sd_rad = map(float, re.findall(r"by (\S+) \+- (\S+) rad", line)[0])
    assert apart_rad == pytest.approx(1.5e-3, abs=5e-5) and 1e-8 < sd_rad < 3e-5
    if not cubic:
        assert abs(np.ptp(found) - 1.5e-3) < 3 * sd_rad < 3e-6
    if not cubic:
        assert fitted.solution.rmse < 1.2 * fitted.floor


@pytest.mark.parametrize(
    "law", [{"gap_rad": 2e-4}, {"error_rad": 1e-4}, {"cubic": 3e5}, {"loop_Nm": 2.0}], ids=lambda law: next(iter(law))
)
def test_zeros_of_a_torque_sensor_are_taken_out_beside_what_is_missing(law: dict[str, float]) -> None:
    """A gap, a kinematic error that makes 3 N m and a loop were not named beside these."""
    swing = Joint(weight_Nm=40.0, **law)
    joints = [replace(swing, sensor_zero_Nm=zero_Nm) for zero_Nm in (0.9, -0.6, 0.2)]
    fitted = fit([joint.recorded(i) for i, joint in enumerate(joints)], BASE)
    line = next(line for line in fitted.problem.remarks if "zeros of the" in line)
    if law.keys() & {"error_rad", "loop_Nm"}:  # beside a straight spring it is either
        apart_Nm, sd_Nm = (STIFFNESS * float(word) for word in re.findall(r"by (\S+) \+- (\S+) rad", line)[0])
    else:
        assert "torque sensor" in line
        apart_Nm, sd_Nm = map(float, re.findall(r"by (\S+) \+- (\S+) N m", line)[0])
    assert apart_Nm == pytest.approx(1.5, abs=0.1) and sd_Nm < 0.15


def test_without_a_torque_sensor_it_may_be_a_steady_load() -> None:
    joints = [Joint(sensor=False), Joint(7e-4, sensor=False)]
    fitted = fit([joint.recorded(i) for i, joint in enumerate(joints)], BASE)
    assert any("(or their steady loads over the stiffness) differ by 0.0007" in row for row in fitted.problem.remarks)
    assert fitted.solution.rmse < 1.2 * fitted.floor


LOADED = Joint(load_Nm=30.0)
HANGING = Joint(weight_Nm=8.0, sensor=False)


@pytest.mark.parametrize(
    "joints",
    [
        (LOADED, replace(LOADED, softer=0.95)),
        (Joint(cubic=1e5), Joint(load_Nm=40.0, cubic=1e5), Joint(load_Nm=-30.0, cubic=1e5)),
        (replace(HANGING, middle_rad=-1.1), HANGING, replace(HANGING, middle_rad=1.4)),
        (LOADED, LOADED),
    ],
    ids=["softer", "spring that bends", "weight in three postures", "same zeros"],
)
def test_a_law_of_the_gear_is_no_zero(joints: tuple[Joint, ...]) -> None:
    problem = fit([joint.recorded(i) for i, joint in enumerate(joints)], BASE).problem
    assert not [line for line in problem.remarks if "zeros" in line]
    assert all(trial.zero_rad == 0.0 for trial in problem.trials)

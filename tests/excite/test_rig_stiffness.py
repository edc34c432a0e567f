"""From the guarded motion to the stiffness, on the rig's own gear: three methods, one answer."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.config.settings import Profile
from edge_daemon.excite.profiles import planned_motion
from edge_daemon.gear import steps
from edge_daemon.gear.torques import law
from edge_daemon.recordings.recording import write_recording
from edge_daemon.rig.motion import MotorCourse
from edge_daemon.rig.plant import SUBSTEP_S, Influence, Joint, Plant, stages
from edge_daemon.servo.cia402_face import Motor
from edge_daemon.stiffness.methods import compare_methods, measure
from tests.excite.drive_bench import Bench, excite, limits

JOINT = Joint(inertia_kg_m2=0.3, stiffness_Nm_per_rad=2.0e4, damping_Nms_per_rad=15.0, ratio=100.0)
LIMITS = {"travel_rad": 40.0, "acceleration_rad_s2": 9000.0, "torque_Nm": 2.0, "following_error_rad": 1.0}
SHAKE = Profile(
    name="shake", kind="multi_tone", speed_rad_s=85.0, seconds=9.0, frequency_hz=(1.3, 3.7, 7.9, 12.7), fade_s=0.5
)


def encoder(angle: list[float] | np.ndarray, bits: int, rng: np.random.Generator) -> np.ndarray:
    step = 2 * math.pi / 2**bits
    return np.round(np.asarray(angle) / step + rng.normal(0, 0.3, len(angle))) * step


@dataclass(frozen=True)
class Creep:
    """A second spring in series with a dashpot beside the gear's own (Maxwell 1867): it holds against speed only."""

    stiffness: float = 4000.0
    time_s: float = 0.03
    start: tuple[float, ...] = (0.0,)

    def grown(self, z: Sequence[float], step_s: float, dphi: float) -> Sequence[float]:
        """Torque after a step: exact for a rate that stays."""
        keep = math.exp(-step_s / self.time_s)
        return (z[0] * keep + self.stiffness * self.time_s * dphi * (1 - keep),)

    def at(
        self, z: Sequence[float], step_s: float, phi: float, dphi: float, speed: float, angle: float
    ) -> tuple[float, float]:
        return 0.5 * (z[0] + self.grown(z, step_s, dphi)[0]), 0.0

    def real(self, frequency_hz: float) -> float:
        """What it adds to the stiffness at a frequency, in phase with the twist."""
        x = (2 * math.pi * frequency_hz * self.time_s) ** 2
        return self.stiffness * x / (1 + x)


def moved(rng: np.random.Generator, *influences: Influence) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray]:
    """The profile through canopen, the drive and the gear, as two encoders saw it, and its phase marks."""
    bench = Bench(excite(limits(**LIMITS)))
    bench.face.motor = Motor(plant=Plant(JOINT, influences))
    rows: list[tuple[float, float, float]] = []
    motor = bench.face.motor
    bench.each_ms = lambda b: rows.append((b.wall_s, motor.position_rad, motor.theta_out_rad))
    outcome = bench.runner().run(planned_motion(SHAKE, bench.settings.cycle_s))
    assert outcome.completed, outcome.reason
    time_s, inner, outer = np.array(rows).T
    columns = {"theta_in_rad": encoder(inner, 20, rng), "theta_out_rad": encoder(outer, 22, rng)}
    stamps = np.concatenate([row.time_s for row in bench.marks])
    phases = np.concatenate([row.value for row in bench.marks])
    return time_s, columns, phases[np.clip(np.searchsorted(stamps, time_s) - 1, 0, None)]


def held(rng: np.random.Generator, *influences: Influence) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The motor stands while the output is loaded in steps of two seconds."""
    levels = np.array([0, 6, 12, 18, 12, 6, 0, -6, -12, -18, -12, -6, 0], dtype=float)

    def load(time_s: np.ndarray, _theta_in: np.ndarray) -> np.ndarray:
        return -levels[np.minimum((time_s / 2).astype(int), len(levels) - 1)]

    plant = Plant(JOINT, (Influence(torque=load), *influences))
    count = round(2 * len(levels) / SUBSTEP_S)
    inside = stages(0, count)
    still = MotorCourse(np.full(len(inside), 7.0), *np.zeros((2, len(inside))))
    twist, _ = plant.run(inside, still, np.full(len(inside), 25.0), compiled=True)
    time_s, seen = (np.arange(count)[7::8] + 1) * SUBSTEP_S, twist[7::8]
    sensor = -load(time_s, seen) + rng.normal(0, 0.02, len(time_s))
    columns = {
        "theta_in_rad": encoder(np.full(len(seen), 7.0), 20, rng),
        "theta_out_rad": encoder(0.07 - seen, 22, rng),
        "torque_out_Nm": sensor,
    }
    return time_s, columns


@pytest.mark.slow
def test_three_methods_one_stiffness() -> None:
    rng = np.random.default_rng(17)
    time_s, columns, phase = moved(rng)
    steady = phase == 2
    assert np.ptp(time_s[steady]) > 8.9  # the marks say which part to measure on
    at = {name: column[steady] for name, column in columns.items()}
    rows = [
        measure("static", *held(rng), JOINT.ratio, JOINT.inertia_kg_m2),
        *(
            measure(method, time_s[steady], at, JOINT.ratio, JOINT.inertia_kg_m2)
            for method in ("frequency-response", "dynamic")
        ),
    ]
    for row in rows:
        assert abs(row.stiffness_Nm_per_rad - 2.0e4) < 4 * row.sd_Nm_per_rad < 0.01 * 2.0e4, row
    compared = compare_methods(rows)
    assert compared.agree, compared


def told(folder: Path, capsys: pytest.CaptureFixture[str], *influences: Influence) -> dict[str, Any]:
    """What `measure all` says of recordings of the rig with these influences."""
    rng = np.random.default_rng(18)
    still_s, still = held(rng, *influences)
    write_recording(folder / "held.csv", still_s, still | {"profile_phase": np.full(len(still_s), 2.0)})
    time_s, columns, phase = moved(rng, *influences)
    write_recording(folder / "shake.csv", time_s, columns | {"profile_phase": phase})
    model = folder / "gear.toml"
    model.write_text(f'[joint]\nbalance = "torsion"\nratio = 100.0\noutput_inertia_kg_m2 = {JOINT.inertia_kg_m2}\n')
    files = [str(folder / name) for name in ("held.csv", "shake.csv")]
    assert main(["measure", "all", *files, "--model", str(model), "--phase", "2", "--json", "-"]) in (0, None)
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def values(found: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {row["method"]: (row["value"], row["sd"]) for row in found["measurements"] if row["best"]}


@pytest.mark.slow
def test_a_gear_that_creeps_is_softer_at_rest_and_the_verdict_names_the_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    creep = Creep()
    found = told(tmp_path, capsys, Influence(twist=creep))
    by = values(found)
    assert abs(by["static"][0] - 2.0e4) < 4 * by["static"][1] < 0.01 * 2.0e4
    low, high = creep.real(1.3), creep.real(12.7)
    for method in ("frequency-response", "dynamic"):
        assert 2.0e4 + low < by[method][0] < 2.0e4 + high
    assert found["agree"] is False and found["verdict"].startswith("softer at rest than in motion")
    assert "static: misses dynamic effects" in found["passed"]
    assert "frequency-response: complex analysis" in found["passed"]  # the answer depends on frequency
    assert all(limit in found["verdict"] for limit in found["passed"])


@pytest.mark.slow
def test_friction_that_holds_at_rest_and_slips_in_motion_is_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stribeck friction of the twist: the static method sees a loop and reads past it, the others see less torque."""
    found = told(tmp_path, capsys, Influence(twist=law(steps.STRIBECK, 2.0, 4.0, 5e-3)))
    by = values(found)
    assert abs(by["static"][0] - 2.0e4) < 4 * by["static"][1] < 0.01 * 2.0e4
    assert by["dynamic"][0] < 0.97 * 2.0e4
    assert not found["agree"] or by["dynamic"][1] > 0.01 * 2.0e4  # told apart, or doubted as much
    assert "dynamic: the model is complete" in found["passed"]
    assert "limits passed" in found["verdict"]


@pytest.mark.slow
def test_nothing_that_depends_on_speed_no_disagreement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = told(tmp_path, capsys)
    assert found["agree"] is True and found["passed"] == []

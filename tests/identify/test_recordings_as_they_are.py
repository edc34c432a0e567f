"""Short files, gaps, coarse angles and a stop at the end: what real machines record, on joints of another hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.motion.kinematics import KinematicsError
from edge_daemon.records import Array
from tests.explain import simulated_drives
from tests.explain.simulated_drives import RATIO, STEP_S, Arm, Joint, record

ARM = Arm(weight_Nm=12.0)
NAMES = ("inertia", "viscous_friction", "coulomb_friction", "gravity_load")
MODEL = Model("drive", RATIO, math.nan, tuple(ModelEffect(name) for name in NAMES))
TRUTH = {
    ("inertia", "inertia"): ARM.inertia_kg_m2,
    ("viscous_friction", "coefficient"): ARM.viscous_Nms,
    ("coulomb_friction", "friction"): ARM.coulomb_Nm,
    ("gravity_load", "sine"): ARM.weight_Nm,
}


@dataclass(frozen=True)
class Part:
    time_s: Array
    columns: dict[str, Array]


def part(joint: Joint, rows: np.ndarray) -> Part:
    return Part(joint.time_s[rows], {name: column[rows] for name, column in joint.columns.items()})


def check(model: Model, share: float) -> None:
    for (effect, name), value in TRUTH.items():
        assert model.value(effect, name) == pytest.approx(value / RATIO, rel=share)


@pytest.mark.filterwarnings("error")
def test_files_of_three_seconds_count_together() -> None:
    joint = record(ARM, 5)
    files = [part(joint, np.flatnonzero(joint.time_s // 3.0 == k)) for k in range(6)]
    with pytest.raises(KinematicsError, match=r"expected at least 6 stretches of 0\.25 s"):
        fit([part(joint, np.flatnonzero(joint.time_s < 1.0))], MODEL)
    check(fit(files[:1], MODEL).model, 0.05)
    fitted = fit(files, MODEL)
    check(fitted.model, 0.02)
    assert fitted.solution.rmse < 1.5 * fitted.floor


def test_short_gaps_are_bridged_and_cost_no_more_than_their_time() -> None:
    joint = record(ARM, 6)
    rng = np.random.default_rng(7)
    kept = np.ones(len(joint.time_s), dtype=bool)
    for start in rng.integers(500, len(kept) - 500, 90):
        kept[start : start + rng.integers(3, 25)] = False
    fitted = fit([part(joint, np.flatnonzero(kept))], MODEL)
    check(fitted.model, 0.02)
    assert fitted.problem.trials[0].seconds > 12.0


@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_slower_sampling_does(rate_hz: float) -> None:
    joint = record(ARM, 8)
    check(fit([part(joint, np.arange(0, len(joint.time_s), round(500 / rate_hz)))], MODEL).model, 0.02)


def test_a_coarse_angle_is_filtered_more_instead_of_being_unsure() -> None:
    joint = record(ARM, 9)
    step = 2 * math.pi / 2**14
    columns = joint.columns | {"theta_out_rad": np.rint(joint.columns["theta_out_rad"] / step) * step}
    fitted = fit([Part(joint.time_s, columns)], MODEL)
    check(fitted.model, 0.08)
    assert fitted.problem.trials[0].seconds > 12.0


@pytest.mark.parametrize("bumped_Nm", [0.0, 0.6, 0.9])
def test_a_stop_that_is_run_into_is_told_and_judged_without(bumped_Nm: float) -> None:
    """A bump besides was taken for the gear: the two held most of the squared error together, or the louder hid it."""
    joint = record(ARM, 10)
    time_s = joint.time_s - joint.time_s[0]
    pushed = np.where(time_s > time_s[-1] - 1.0, 0.9, 0.0) - bumped_Nm * np.exp(-(((time_s - 7.0) / 0.2) ** 8))
    columns = joint.columns | {"torque_in_Nm": joint.columns["torque_in_Nm"] + pushed}
    fitted = fit([replace(joint, columns=columns)], MODEL)
    said = [line for line in fitted.problem.remarks if "of the squared error" in line]
    assert len(said) == 1 and said[0].count(" to ") == 1 + bool(bumped_Nm)
    check(fitted.model, 0.02)
    assert not fit([joint], MODEL).problem.remarks


def test_the_one_fast_move_of_a_recording_is_no_event(monkeypatch: pytest.MonkeyPatch) -> None:
    """A law that grows with speed showed there alone: it was judged without, and the model was adequate."""

    def course(seconds: float, rng: np.random.Generator, pace: float = 1.0) -> tuple[Array, Array, Array]:
        t = np.arange(round(seconds / STEP_S)) * STEP_S
        speed = 0.5 * np.sin(1.7 * t) + 0.3 * np.sin(4.1 * t) + 2.5 * np.exp(-(((t - 11.0) / 0.3) ** 4))
        return np.cumsum(speed) * STEP_S, speed, np.gradient(speed, STEP_S)

    monkeypatch.setattr(simulated_drives, "course", course)
    joint = record(ARM, 4, 40.0)
    angle = joint.columns["theta_out_rad"]
    law = 0.03 * np.sin(3 * angle) * (np.gradient(angle) / np.gradient(joint.time_s)) ** 2
    columns = joint.columns | {"torque_in_Nm": joint.columns["torque_in_Nm"] + law}
    fitted = fit([replace(joint, columns=columns)], MODEL)
    assert not fitted.problem.remarks and fitted.solution.rmse > 5 * fitted.floor

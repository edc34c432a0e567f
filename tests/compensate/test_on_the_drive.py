"""Offsets on the simulated drive, over a CAN bus as CiA 402 has them; judged by an encoder that they never see."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.compensate.feedforward import Feedforward, feedforward
from edge_daemon.compensate.gate import gated
from edge_daemon.demo.compensated_drive import CYCLE_S, RATE_HZ, BothAngles, fitted, moved, path_of, slow_turns
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.records import Array
from edge_daemon.servo.drive import JOINT, KINEMATIC_ERROR_RAD, ARM_Nm

pytestmark = pytest.mark.slow


def error_rms(target: Array, output: Array, after_s: float = 2.0) -> float:
    """Output against target, less a constant and a delay of the whole drive."""
    first = round(after_s / CYCLE_S)
    wrong = (output - target)[first:]
    columns = np.column_stack([np.ones(len(wrong)), np.gradient(target, CYCLE_S)[first:]])
    return float(np.sqrt(np.mean((wrong - columns @ np.linalg.lstsq(columns, wrong, rcond=None)[0]) ** 2)))


def parameter(value: float, share: float = 0.01) -> FittedParameter:
    return FittedParameter(value, abs(value) * share + 1e-9, "1", True)


def model(
    stiffness: float = JOINT.stiffness_Nm_per_rad, wave: float = KINEMATIC_ERROR_RAD, arm: float = ARM_Nm
) -> Model:
    """As a fit writes it; the truth by default."""
    waves = {name: parameter(0.0) for name in ("sine_1", "cosine_1", "cosine_2", "sine_4", "cosine_4")}
    return Model(
        "torsion",
        JOINT.ratio,
        JOINT.inertia_kg_m2,
        (
            ModelEffect("linear_stiffness", {"stiffness": parameter(stiffness)}),
            ModelEffect("viscous_damping", {"damping": parameter(JOINT.damping_Nms_per_rad)}),
            ModelEffect("kinematic_error", {**waves, "sine_2": parameter(wave)}),
            ModelEffect("gravity_load", {"sine": parameter(arm), "cosine": parameter(0.0)}),
        ),
    )


@pytest.fixture(scope="module")
def plain() -> tuple[Array, BothAngles]:
    target = slow_turns(10.0)  # a whole turn to and fro is judged
    return target, moved(target, None)


def test_the_kinematic_error_falls_to_a_tenth(plain: tuple[Array, BothAngles]) -> None:
    """Both runs with the twist mended, so that what is left is the transmission's."""
    target, _ = plain
    ready = feedforward(model())
    twist_only = moved(target, ready.without("kinematic", "asked").offsets(path_of(target)))[1]
    both = moved(target, ready.offsets(path_of(target)))[1]
    assert error_rms(target, both) < 0.1 * error_rms(target, twist_only)


def test_the_twist_falls_to_a_fifth_also_at_a_stiffness_ten_percent_wrong(
    plain: tuple[Array, BothAngles],
) -> None:
    target, (_, output) = plain
    for stiffness in (1.0, 0.9):
        ready = feedforward(model(stiffness=stiffness * JOINT.stiffness_Nm_per_rad))
        mended = moved(target, ready.offsets(path_of(target)))[1]
        assert error_rms(target, mended) < 0.2 * error_rms(target, output)


def test_the_demonstration_finds_a_fit_worth_more_than_a_catalogue(tmp_path: Path) -> None:
    """All through the protocol: a recording of the drive, a fit of it, and another motion with what was fitted."""
    assert main(["compensate", "--demo", "--json", str(tmp_path / "found.json")]) == 0
    found = json.loads((tmp_path / "found.json").read_text())
    error = found["output_error_rad"]
    assert error["maker's values"] < 0.5 * error["without"]
    assert error["fitted model"] < 0.1 * error["maker's values"]
    assert error["a wrong model, gated"] < 1.02 * error["without"]
    assert 0.0 < found["ringing_rad"]["shaped"] < 0.1 * found["ringing_rad"]["plain"]


def test_the_demonstration_learns_the_drives_stiffness() -> None:
    assert fitted().value("linear_stiffness", "stiffness") == pytest.approx(2e4, rel=0.005)


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
    plain: tuple[Array, BothAngles], wrong: dict[str, float]
) -> None:
    """The gate looks at a recording of the drive, as `compensate --recording` does."""
    target, (motor, output) = plain
    ready = gated(feedforward(model(**wrong)), RATE_HZ, motor, output, None)
    assert ready.off
    mended = moved(target, ready.offsets(path_of(target)))[1]
    assert error_rms(target, mended) < 1.02 * error_rms(target, output)


def test_a_right_model_passes_the_gate(plain: tuple[Array, BothAngles]) -> None:
    _, (motor, output) = plain
    assert not gated(feedforward(model()), RATE_HZ, motor, output, None).off


def test_an_estimate_that_ceases_to_be_valid_fades_out_without_a_step(plain: tuple[Array, BothAngles]) -> None:
    target, (motor, _) = plain
    offsets = feedforward(model()).offsets(path_of(target))
    half = len(target) // 2
    added = moved(target, offsets, lambda k: k < half)[0] - motor
    assert np.abs(added[half + round(0.7 / CYCLE_S) :]).max() < 1e-3
    assert np.abs(np.diff(added[half - 5 :])).max() < 3e-3


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

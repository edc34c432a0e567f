"""A daemon that starts again with another model: nothing of the gear is lost by it, and nothing jumps."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge_daemon.prognose.trends import ConditionWatch
from edge_daemon.records import Estimate, Readings, Status
from edge_daemon.service.pipeline import open_pipeline
from tests.service.scenario import COMPLETE, START_S, drive_settings, model_text

LOST, SD = -0.04, 0.001
STIFFNESS = 96_000.0


def written(folder: Path, effects: tuple[str, ...]) -> None:
    (folder / "axis.model.toml").write_text(model_text(effects))


def baseline(blob: bytes) -> dict[str, float | None]:
    return msgspec.json.decode(blob)["baseline"]


def commissioned(folder: Path) -> dict[str, bytes]:
    """Checkpoints of a drive that has lost four per cent of its stiffness, under a model without friction."""
    written(folder, COMPLETE[:-1])
    settings = drive_settings()
    parts = open_pipeline(settings, folder).state()
    estimates = msgspec.json.decode(parts["estimates"])
    value = STIFFNESS / (1 + LOST)
    estimates["baseline"].update(valid_s=100.0, value=value, sd=SD * value, _change=LOST, _change_sd=SD)
    watch = ConditionWatch(settings.name, open_pipeline(settings, folder).life.gear)
    for name in ("stiffness", "damping", "temperature_rise"):
        watch.update(1.0, {name: Estimate(name, 10.0, 0.1, "", Status.VALID, 0.0)})
    return {**parts, "estimates": msgspec.json.encode(estimates), "trends": watch.state()}


def charts(blob: bytes) -> set[str]:
    return set(msgspec.msgpack.decode(blob)["charts"])


def test_a_restart_with_another_model_keeps_what_the_gear_lost_and_says_so(tmp_path: Path) -> None:
    parts = commissioned(tmp_path)
    written(tmp_path, COMPLETE)
    pipeline = open_pipeline(drive_settings(), tmp_path)
    assert pipeline.restore(parts) == ("estimates",)
    state = pipeline.state()
    kept = baseline(state["estimates"])
    assert (kept["kept"], kept["kept_sd"], kept["value"]) == (LOST, SD, None)
    assert charts(parts["trends"]) == {"stiffness", "damping", "temperature_rise"}
    assert charts(state["trends"]) == {"stiffness", "temperature_rise"}
    at_s = START_S + np.arange(200) / 1000.0
    for signal in ("EncoderIn1.Position", "EncoderOut1.Position"):
        pipeline.push(Readings("can0", signal, at_s, np.arange(200.0)))
    said = [event.message for event in pipeline.step(START_S + 0.3, ()).events]
    assert any("another model than before the restart" in text and "is kept" in text for text in said)
    stiffer = Estimate("stiffness", 1.1 * STIFFNESS, 1.0, "N m/rad", Status.VALID, 0.0)
    assert pipeline.estimator.referred(stiffer).status is Status.INVALID


def test_a_restart_with_the_same_model_changes_nothing(tmp_path: Path) -> None:
    parts = commissioned(tmp_path)
    pipeline = open_pipeline(drive_settings(), tmp_path)
    assert pipeline.restore(parts) == ()
    state = pipeline.state()
    assert baseline(state["estimates"])["value"] == pytest.approx(STIFFNESS / (1 + LOST))
    assert charts(state["trends"]) == charts(parts["trends"])

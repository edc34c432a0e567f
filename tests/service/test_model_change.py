"""A daemon that starts again with another model: nothing of the gear is lost by it, and nothing jumps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge_daemon.config.settings import StoreSettings
from edge_daemon.health.order_trends import OrderWatch
from edge_daemon.health.trends import ConditionWatch
from edge_daemon.prognose.life import ROW_H, LifeFollower
from edge_daemon.publish.messages import Composer
from edge_daemon.records import NE107, Estimate, Readings, Status
from edge_daemon.rig.faults import planned
from edge_daemon.service.history import History
from edge_daemon.service.pipeline import open_pipeline
from edge_daemon.service.recommission import NOT_STORED
from edge_daemon.usage.ledger import rows_of
from tests.service.scenario import COMPLETE, START_S, Scene, drive_settings, model_text, scene

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
    assert pipeline.estimator.baseline.referred(stiffer).status is Status.INVALID


WORE = 0.03
WITHOUT = COMPLETE[:-1]


def stored(folder: Path, until_s: float, models: list[tuple[float, tuple[str, ...]]]) -> Scene:
    """A drive that is commissioned without friction in its model and whose motion is stored, at this time."""
    it = scene(folder, WITHOUT, baseline_after_s=15.0)
    it.history = History(StoreSettings(file="ring.sqlite"), folder)
    it.models = models
    for look in it.run(until_s):
        if round(look.time_s * 10) % 50 == 0:
            it.history.commit()
    return it


def restarted(it: Scene, effects: tuple[str, ...]) -> Scene:
    """The daemon starts again with a model of these effects."""
    parts = it.pipeline.state()
    written(it.folder, effects)
    it.pipeline = open_pipeline(drive_settings(15.0), it.folder)
    it.pipeline.restore(parts)
    return it


@pytest.mark.slow
def test_what_the_gear_lost_is_told_by_a_new_model_from_the_stored_motion_of_commissioning(tmp_path: Path) -> None:
    """It lost three per cent while the daemon was off: only the motion of commissioning, seen by the model that is in
    force now, tells that."""
    it = restarted(stored(tmp_path, 32.0, []), COMPLETE)
    it.plan = [planned(f"wear@33:{WORE:.0%}")]
    *_, last = it.run(60.0)
    change = last.estimates["stiffness_change"]
    assert change.status is Status.VALID and abs(change.value + WORE) < 4 * change.sd < 0.01
    assert any("learned from the stored motion" in text for text in it.told)
    assert any("another model than before the restart" in text for text in it.told)


@pytest.mark.slow
def test_without_stored_motion_the_reference_is_learned_anew_and_that_is_said(tmp_path: Path) -> None:
    it = stored(tmp_path, 32.0, [(32.5, COMPLETE)])
    it.history = History(StoreSettings(file="lost.sqlite"), tmp_path)
    *_, last = it.run(45.0)
    assert NOT_STORED in it.told and last.estimates["stiffness_change"].value == pytest.approx(0.0, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["wear:3%", "scaled_in:0.1%", "latch_shift:0.3ms"])
def test_what_happens_while_another_model_is_tried_is_seen_and_said(tmp_path: Path, fault: str) -> None:
    """Nothing is stored. The reference of before hid three per cent of wear, and a model that learned from a scaled
    encoder stood as well beside an error of more than the whole torque."""
    it = scene(tmp_path, COMPLETE, baseline_after_s=12.0)
    *_, before = it.run(24.0)
    name, _, size = fault.partition(":")
    it.plan = [planned(f"{name}@24:{size}" if name == "wear" else f"{name}@24-34:{size}")]
    it.models = [(24.5, WITHOUT), (28.0, COMPLETE)]
    seen = list(it.run(50.0))
    assert [look.time_s for look in seen if look.wrong(before.standing())] == []
    errors = [look for look in seen if look.usable("model_nrmse") and look.estimates["model_nrmse"].value > 1.0]
    assert not any(look.state is NE107.OK for look in errors)
    assert seen[-1].right({}, ("stiffness", "damping", "coulomb_friction"))
    change = seen[-1].estimates["stiffness_change"]
    assert change.status is Status.VALID and change.sd < 0.005
    if name == "wear":
        assert change.value == pytest.approx(-WORE, abs=0.002) and any("exchanged" in text for text in it.told)
    else:
        assert any(look.state is NE107.FUNCTION_CHECK for look in seen if look.time_s < 27.0)


def test_orders_of_a_model_are_published_with_their_names_and_go_with_it(tmp_path: Path) -> None:
    """A tooth that passes 202 times per turn: its wave was dropped without a word, and a new order was no new model."""
    it = scene(tmp_path)
    text = model_text(COMPLETE).replace('"kinematic_error"\n', '"kinematic_error"\norders = {output = [202]}\n')
    it.pipeline.model_file.write_text(text)
    assert it.pipeline.follow_model(START_S)
    *_, last = it.run(25.0)
    tooth = last.estimates["kinematic_error_202_output"]
    assert tooth.status is Status.VALID and tooth.value < 4 * tooth.sd < 1e-5, "this gear has none"
    lobes = last.estimates["kinematic_error_2"]
    assert lobes.status is Status.VALID and abs(2 * lobes.value - last.truth["kinematic_error"]) < 8 * lobes.sd
    snapshot = it.pipeline.step(START_S + it.drive.time_s, ()).snapshot
    (document,) = (m.document for m in Composer(1, 0.0).of_snapshot(snapshot) if m.topic == "stiffness")
    orders = {row["name"]: row for row in document["orders"]}
    assert "fits a circular spline tooth pass" in orders[tooth.name]["meaning"]
    assert orders[lobes.name]["value"] == lobes.value and orders[lobes.name]["status"] == "valid"
    it.pipeline.model_file.write_text(model_text(WITHOUT))
    it.pipeline.follow_model(START_S + it.drive.time_s)
    *_, last = it.run(it.drive.time_s + 1.0)
    assert not {tooth.name, "coulomb_friction"} & last.estimates.keys() and "stiffness" in last.estimates


LIFE_H = 600


def aged(life: LifeFollower, stiffness: float) -> None:
    """A past of some hundred hours in which the gear lost two per cent, as its model saw that."""
    hours = np.arange(1.0, LIFE_H + 1)
    columns = {
        "speed_in_rpm": np.full(LIFE_H, 1500.0),
        "torque_cubic_mean_Nm": np.full(LIFE_H, 30.0),
        "stiffness_Nm_per_rad": stiffness * np.linspace(1.02, 1.0, LIFE_H),
    }
    assert life.gear is not None
    life.ledger = rows_of(life.gear, hours, np.ones(LIFE_H), columns)


def damage(it: Scene) -> float:
    """As a forecast after the running hour finds it."""
    pipeline = it.pipeline.life
    pipeline.hour.hours = ROW_H
    *_, last = it.run(it.drive.time_s + 0.4)
    task = pipeline.forecast_task()
    if task is not None:
        pipeline.accept(task())
    *_, last = it.run(it.drive.time_s + 0.4)
    return last.estimates["damage"].value


@pytest.mark.slow
@pytest.mark.parametrize("restarts", [False, True])
def test_damage_does_not_jump_by_a_model(tmp_path: Path, restarts: bool) -> None:
    """The model without friction finds the gear 1 % stiffer or more; the hour itself adds what it adds."""
    it = stored(tmp_path, 32.0, [])
    aged(it.pipeline.life, it.pipeline.estimator.tracker.stiffness)
    before, hour_later = damage(it), damage(it)
    if restarts:
        it = restarted(it, COMPLETE)
    else:
        it.models = [(it.drive.time_s, COMPLETE)]
    list(it.run(it.drive.time_s + 35.0))
    after = damage(it)
    added = abs(hour_later - before)
    assert abs(after - hour_later) < 2 * added + 1e-4 * before and before > 0.001


def test_a_tooth_that_wears_is_alarmed_by_the_chain_and_another_model_begins_anew(tmp_path: Path) -> None:
    """The chain's own hours, made of what it publishes; the weeks are those of a watch that it takes up."""
    it = scene(tmp_path)
    text = model_text(COMPLETE).replace('"kinematic_error"\n', '"kinematic_error"\norders = {output = [202]}\n')
    it.pipeline.model_file.write_text(text)
    it.pipeline.follow_model(START_S)
    *_, last = it.run(25.0)
    watch, tooth = OrderWatch(it.pipeline.drive.name, it.pipeline.life.gear, 240.0), "kinematic_error_202_output"
    sound = {**last.estimates, tooth: replace(last.estimates[tooth], value=1e-6, sd=1e-7)}
    worn = {**sound, tooth: replace(sound[tooth], value=5e-5)}
    for hour in range(300 + 24 * 10):
        watch.update(1.0, sound if hour < 300 else worn, {tooth: "a tooth"})
    parts = it.pipeline.state()
    assert "orders" in parts
    it.pipeline = open_pipeline(drive_settings(), tmp_path)
    assert it.pipeline.restore({**parts, "orders": watch.state()}) == ()
    *_, last = it.run(26.5)
    (alarm,) = (row for row in it.pipeline.alarms if row.key == "orders")
    assert "a tooth" in alarm.text and last.state is NE107.MAINTENANCE_REQUIRED
    it.pipeline.acknowledge(START_S + 26.5)
    it.models = [(26.5, COMPLETE)]
    *_, last = it.run(28.0)
    assert not [row for row in it.pipeline.alarms if row.key == "orders"]


@pytest.mark.slow
def test_a_change_of_model_is_told_and_what_is_kept_goes_on_where_it_stood(tmp_path: Path) -> None:
    """What another model sees is no row of the ledger before it is known how both see one gear."""
    it, column = stored(tmp_path, 32.0, []), "stiffness_Nm_per_rad"
    first = it.pipeline.estimator.tracker.stiffness
    total, count = it.pipeline.life.hour.values[column]
    it.pipeline.model_file.write_text(model_text(COMPLETE))
    (event,) = it.pipeline.follow_model(START_S + 32.0)
    assert event.source == "model" and "coulomb_friction" in event.message and "is kept" in event.message
    list(it.run(33.0))
    assert it.pipeline.life.hour.values[column][1] == pytest.approx(count, abs=3), "the newest block was of before"
    list(it.run(70.0))
    second = it.pipeline.estimator.tracker.stiffness
    later, grown = it.pipeline.life.hour.values[column]
    assert abs(second / first - 1) > 0.005 and grown > count + 30
    assert (later - total) / (grown - count) == pytest.approx(first, rel=0.003)


def test_a_restart_with_the_same_model_changes_nothing(tmp_path: Path) -> None:
    parts = commissioned(tmp_path)
    pipeline = open_pipeline(drive_settings(), tmp_path)
    assert pipeline.restore(parts) == ()
    state = pipeline.state()
    assert baseline(state["estimates"])["value"] == pytest.approx(STIFFNESS / (1 + LOST))
    assert charts(state["trends"]) == charts(parts["trends"])

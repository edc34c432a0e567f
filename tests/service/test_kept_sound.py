"""The whole way of a sound: heard by a drive, kept in its store over a restart, exported, an order looked for."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.config.settings import ChannelSettings, Drive, Sound, StoreSettings
from edge_daemon.recordings.recording import read_recording
from edge_daemon.records import Burst, Readings, SourceHealth
from edge_daemon.service.history import History
from edge_daemon.service.pipeline import Pipeline
from tests.motion import simulated_joint as rig

BEGIN_S, RATE_HZ, SIZE = 1_763_701_200.0, 8000.0, 8000
SPEED_RAD_S, ORDER = 30.0 * 2.0 * math.pi, 11.4
DRIVE = Drive(
    name="axis",
    modbus_device_id=1,
    model="m",
    channels=(
        ChannelSettings(channel="theta_in_rad", source="can", signal="in"),
        ChannelSettings(channel="theta_out_rad", source="can", signal="out"),
    ),
    sound=Sound(source="mic", signal="sound", low_hz=20.0, high_hz=3500.0),
)


def run(folder: Path, history: History, begin_s: float, line: float) -> None:
    """Some seconds of turning, with white noise and a line; then a restart could follow."""
    pipeline = Pipeline(DRIVE, folder / "m.toml", rig.model_of(rig.Joint()), None)
    assert pipeline.restore(history.load("axis", Pipeline.PARTS)) == ()
    rng = np.random.default_rng(round(begin_s))
    for second in range(6):
        now_s = begin_s + second
        time_s = now_s + np.arange(1000) / 1000.0
        pipeline.push(Readings("can", "in", time_s, SPEED_RAD_S * (time_s - BEGIN_S)))
        pipeline.push(Readings("can", "out", time_s, SPEED_RAD_S / 100.0 * (time_s - BEGIN_S)))
        value = 0.02 * rng.normal(size=SIZE)
        value += line * np.sin(ORDER * SPEED_RAD_S * np.arange(SIZE) / RATE_HZ)
        pipeline.push(Burst("mic", "sound", now_s, RATE_HZ, value))
        state = "down" if second > 1 else "ok"
        step = pipeline.step(now_s + 1.0, [SourceHealth("can", state, "unplugged", now_s, {})])
        history.add_snapshot(step.snapshot)
    history.save("axis", pipeline.state())
    history.commit()


def test_from_a_burst_to_an_exported_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = History(StoreSettings(file="s.sqlite", max_mib=8), tmp_path)
    for hour, line in ((0, 0.0), (1, 0.01), (30, 0.01)):
        run(tmp_path, history, BEGIN_S + 3600.0 * hour, line)
    history.close()
    store, out = tmp_path / "s.sqlite", tmp_path / "sound.csv"
    assert main(["export", "--store", str(store), "--sound", "--order", str(ORDER), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "heard when" in told and "can" in told
    kept = read_recording(out)
    moving = np.abs(kept.columns["speed_in_rad_s"] - SPEED_RAD_S) < 0.1 * SPEED_RAD_S
    hour = (kept.time_s[moving] - BEGIN_S) // 3600.0
    assert set(hour) == {0.0, 1.0, 30.0}
    level = kept.columns["order_11.4_dB"][moving]
    assert level[hour == 0.0].max() < 6.0 < 8.0 < level[hour > 0.0].min()
    burst = read_recording(tmp_path / "sound.burst1.csv")
    assert len(burst.columns["sound"]) == SIZE
    assert np.std(burst.columns["sound"]) == pytest.approx(0.02, rel=0.1)


def test_what_cannot_be_exported_is_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = History(StoreSettings(file="s.sqlite", max_mib=8), tmp_path)
    pipeline = Pipeline(
        Drive(name="axis", modbus_device_id=1, model="m", channels=DRIVE.channels),
        tmp_path / "m",
        rig.model_of(rig.Joint()),
        None,
    )
    history.add_snapshot(pipeline.step(BEGIN_S, ()).snapshot)
    time_s = BEGIN_S + np.arange(1000) / 1000.0
    pipeline.push(Readings("can", "in", time_s, time_s - BEGIN_S))
    pipeline.push(Readings("can", "out", time_s, time_s - BEGIN_S))
    history.add_snapshot(pipeline.step(BEGIN_S + 2.0, ()).snapshot)
    history.commit()
    history.close()
    arguments = ["export", "--store", str(tmp_path / "s.sqlite"), "--out", str(tmp_path / "o.csv")]
    assert main([*arguments, "--sound"]) == 2
    assert "no sound of axis is kept" in capsys.readouterr().err
    assert main([*arguments, "--order", "2"]) == 2
    assert "--sound" in capsys.readouterr().err

"""A drive without motor encoder: its configuration, and the whole way from readings to a stiffness."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.config.reading import load
from edge_daemon.config.settings import ChannelSettings, Drive, Estimation, Sound, SoundAngle
from edge_daemon.errors import BadInput
from edge_daemon.records import Burst, Readings, Status
from edge_daemon.service.pipeline import Pipeline
from tests.motion import simulated_joint as rig
from tests.sound.test_sound_angle import START_S, colour, motor_and_output, sound_of

HEAD = """
[[modbus]]
name = "ear"
reads = [{ signal = "sound", type = "waveform_i16", address = 0, count = 100, rate_hz = 25600.0 }]
[[file]]
name = "f"
file = "x.csv"
[[drive]]
name = "axis"
modbus_device_id = 1
model = "m.toml"
channels = [CHANNELS]
"""
OUT = '{ channel = "theta_out_rad", source = "f", signal = "out" }'
IN = '{ channel = "theta_in_rad", source = "f", signal = "in" }'
SOUND = '[drive.sound]\nsource = "ear"\nsignal = "sound"\n'
ANGLE = "[drive.sound_angle]\norder = 8\n"


@pytest.mark.parametrize(
    ("channels", "sections", "words"),
    [
        (OUT, ANGLE, "no .drive.sound."),
        (f"{OUT}, {IN}", SOUND + ANGLE, "one or the other"),
        ("", SOUND + ANGLE, "no channel theta_out_rad"),
    ],
)
def test_what_cannot_be_heard_is_refused(tmp_path: Path, channels: str, sections: str, words: str) -> None:
    file = tmp_path / "c.toml"
    file.write_text(HEAD.replace("CHANNELS", channels) + sections)
    with pytest.raises(BadInput, match=words):
        load(file)


def test_a_drive_without_motor_encoder_is_taken(tmp_path: Path) -> None:
    file = tmp_path / "c.toml"
    file.write_text(HEAD.replace("CHANNELS", OUT) + SOUND + ANGLE)
    found = load(file).drive[0].sound_angle
    assert found is not None and found.order == 8


def test_from_readings_and_bursts_to_a_stiffness(tmp_path: Path) -> None:
    """Nothing but an output encoder and a microphone: the noise floor, too, is learned from the same sound."""
    joint = rig.Joint(stiffness=2e4, inertia=0.3, damping=15.0, kinematic_pp=1e-4, out_bits=24)
    theta_in, theta_out = motor_and_output(joint, 24.0, 3)
    sound = sound_of(theta_in, 2e-7, np.random.default_rng(3))
    out = ChannelSettings(channel="theta_out_rad", source="can", signal="out", counts_per_turn=2**24)
    drive = Drive(
        name="axis",
        modbus_device_id=1,
        model="m",
        channels=(out,),
        sound=Sound(source="mic", signal="sound"),
        sound_angle=SoundAngle(order=8, other_orders=(1, 2)),
        estimation=Estimation(warm_up_s=5.0, cutoff_hz=50.0, stiffness_drift_per_h=1e-6),
    )
    pipeline = Pipeline(drive, tmp_path / "m.toml", rig.model_of(joint), None)
    counts = np.round(theta_out * 2**24 / (2 * math.pi))
    for i in range(48):  # half a second at a time, the sound half a second late
        rows = slice(500 * i, 500 * (i + 1))
        time_s = START_S + np.arange(500 * i, 500 * (i + 1)) / 1000.0
        pipeline.push(Readings("can", "out", time_s, counts[rows]))
        if i:
            first = 12_800 * (i - 1)
            pipeline.push(Burst("mic", "sound", START_S + 0.5 * (i - 1), 25_600.0, sound[first : first + 12_800]))
        estimates = pipeline.step(START_S + 0.5 * (i + 1), ()).snapshot.estimates
    heard, stiffness = estimates["sound_angle_sd"], estimates["stiffness"]
    assert heard.status is Status.VALID
    exact = math.sqrt(2e-7 * colour(np.linspace(77, 177, 50)).mean() * 1000.0) / 8
    assert heard.value == pytest.approx(exact, rel=0.35)  # the line is wide, and the floor beside it is what is left
    assert estimates["sound_angle_slips"].value == 0
    assert stiffness.status is Status.VALID and stiffness.sd < 0.05 * 2e4
    assert abs(stiffness.value - 2e4) < 4 * stiffness.sd
    assert "ratio" not in estimates  # what is heard was found by means of it

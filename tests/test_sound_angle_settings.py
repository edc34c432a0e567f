"""A drive without motor encoder, by its configuration."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_daemon.errors import BadInput
from edge_daemon.configuration import load

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

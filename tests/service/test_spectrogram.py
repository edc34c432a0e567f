"""The picture of kept sound: levels against a density that is known, and a line that came up found at its place."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.config.settings import Sound, StoreSettings
from edge_daemon.records import Burst
from edge_daemon.service.history import History
from edge_daemon.service.spectrogram import MOST_BANDS, MOST_SLOTS, sound_picture
from edge_daemon.sound.kept_sound import KeptSound

SETTINGS = Sound(source="mic", signal="sound", low_hz=20.0, high_hz=3500.0)
RATE_HZ, SIZE, SD = 8000.0, 4096, 0.02
NOISE_DB = 10.0 * math.log10(2.0 * SD**2 / RATE_HZ)
"""One-sided density of white noise of this sd."""
LINE_HZ, DAYS, FAST_RAD_S = 410.0, 30, 150.0


def kept(folder: Path, line: float) -> Path:
    """A month of a gear that turns in some hours of a day and stands in others; from the middle on it hums."""
    rng, sound = np.random.default_rng(12), KeptSound(SETTINGS)
    history = History(StoreSettings(file="s.sqlite", max_mib=8), folder)
    at = np.arange(SIZE) / RATE_HZ
    for hour in range(0, 24 * DAYS, 4):
        speed = 0.0 if hour % 24 == 0 else FAST_RAD_S
        hum = line * SD * np.sin(2.0 * math.pi * LINE_HZ * at) if speed and hour > 12 * DAYS else 0.0
        sound.hear(Burst("mic", "sound", 3600.0 * hour, RATE_HZ, SD * rng.normal(size=SIZE) + hum), speed)
        history.save("axis", sound.state())
    history.close()
    return folder / "s.sqlite"


def test_a_line_that_came_up_is_found_and_the_rest_is_as_it_was(tmp_path: Path) -> None:
    found = sound_picture(kept(tmp_path, 0.8), "axis", {})
    level = np.array([[math.nan if v is None else v for v in row] for row in found["level_dB"]])
    hz = np.array(found["frequency_hz"])
    assert level.shape == (len(found["time_s"]), hz.size)
    assert len(level) <= MOST_SLOTS and hz.size <= MOST_BANDS and len(json.dumps(found)) < 80_000
    assert found["regimes"][0][0] == 0 and found["regime"] > 0
    assert found["change"]["sure"] and found["change"]["dB"] > 6.0
    assert found["change"]["frequency_hz"] == pytest.approx(LINE_HZ, rel=0.12)
    far = np.abs(np.log2(hz / LINE_HZ)) > 0.3
    assert np.nanmean(level[:, far]) == pytest.approx(NOISE_DB, abs=0.7)


def test_months_alike_are_called_alike_and_a_regime_can_be_chosen(tmp_path: Path) -> None:
    store = kept(tmp_path, 0.0)
    assert not sound_picture(store, "axis", {})["change"]["sure"]
    standing = sound_picture(store, "axis", {"regime": "0"})
    assert standing["regime"] == 0 and len(standing["time_s"]) == DAYS
    late = sound_picture(store, "axis", {"since_s": str(3600.0 * 24 * 20)})
    assert min(late["time_s"]) >= 3600.0 * 24 * 20


def test_what_is_not_there_or_makes_no_sense_is_said(tmp_path: Path) -> None:
    store = kept(tmp_path, 0.0)
    assert sound_picture(store, "other", {})["time_s"] == []
    for asked in ({"since_s": "soon"}, {"regime": "nan"}, {"until_s": "inf"}):
        with pytest.raises(ValueError, match="expected a"):
            sound_picture(store, "axis", asked)

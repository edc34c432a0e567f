"""Sound kept for months: levels against a density that is known, orders found later, a ring that does not grow."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from edge_daemon.config.settings import Sound
from edge_daemon.records import Burst
from edge_daemon.sound.kept_sound import (
    BURSTS,
    CURRENT,
    DAY_BYTES,
    DAYS,
    HourSpectrum,
    KeptSound,
    bursts,
    heard,
    order_level,
)

SETTINGS = Sound(source="mic", signal="sound", low_hz=20.0, high_hz=3500.0)
RATE_HZ, SIZE, SD = 8000.0, 4096, 0.02
NOISE = 2.0 * SD**2 / RATE_HZ
"""One-sided density of white noise of this sd."""
FAST_RAD_S, SLOW_RAD_S = 150.0, 20.0


def sound(rng: np.random.Generator, time_s: float, speed_rad_s: float, order: float = 0.0) -> Burst:
    """White noise, with a line at an order per turn of the motor where one is given."""
    at = np.arange(SIZE) / RATE_HZ
    line = 0.4 * SD * np.sin(order * speed_rad_s * at + rng.uniform(0.0, 6.0)) if order else 0.0
    return Burst("mic", "sound", time_s, RATE_HZ, SD * rng.normal(size=SIZE) + line)


def hear_day(kept: KeptSound, rng: np.random.Generator, day: int, order: float = 0.0) -> None:
    for hour in range(24):
        for i, speed in enumerate((FAST_RAD_S, SLOW_RAD_S, 0.0)):
            kept.hear(sound(rng, (24 * day + hour) * 3600.0 + 600.0 * i, speed, order if speed else 0.0), speed)


def test_hours_and_speeds_have_spectra_of_their_own() -> None:
    rng, kept = np.random.default_rng(1), KeptSound(SETTINGS)
    for hour in (0, 1):
        for second in range(0, 3600, 300):
            kept.hear(sound(rng, 3600.0 * hour + second, FAST_RAD_S), FAST_RAD_S)
            kept.hear(sound(rng, 3600.0 * hour + second, SLOW_RAD_S), SLOW_RAD_S)
    found = heard(kept.state())
    assert [(one.time_s, round(one.speed_rad_s)) for one in found] == [
        (1800.0, 150), (1800.0, 20), (5400.0, 150), (5400.0, 20)
    ]  # fmt: skip
    for one in found:
        known = np.isfinite(one.psd)
        assert known.sum() > 50
        assert 10.0 * np.log10(np.mean(one.psd[known]) / NOISE) == pytest.approx(0.0, abs=0.5)
        assert one.averages > 12


def test_an_order_is_looked_for_again_later() -> None:
    """Nobody knew of order 11.4 when it was heard; a day costs no more than it says."""
    rng, kept = np.random.default_rng(2), KeptSound(SETTINGS)
    blobs: dict[str, bytes] = {}
    for day, order in enumerate((0.0, 0.0, 11.4, 11.4)):
        hear_day(kept, rng, day, order)
        blobs |= kept.state()
    assert max(len(blob) for blob in blobs.values()) < DAY_BYTES
    found = heard(blobs)
    assert len(found) == 4 * 24 * 3
    level = order_level(found, 11.4)
    day = np.array([one.time_s // 86_400.0 for one in found])
    fast = np.array([one.speed_rad_s > 100.0 for one in found])
    assert np.isnan(level[[one.speed_rad_s == 0.0 for one in found]]).all()
    assert np.median(level[fast & (day < 2)]) < 4.0
    assert np.median(level[fast & (day >= 2)]) > 8.0
    assert np.median(order_level(found, 7.0)[fast & (day >= 2)]) < 4.0


def test_the_ring_does_not_grow_and_survives_a_restart() -> None:
    rng, blobs = np.random.default_rng(3), dict[str, bytes]()
    for day in range(DAYS + 3):
        kept = KeptSound(SETTINGS)
        assert CURRENT not in blobs or kept.restore(blobs[CURRENT])
        kept.hear(sound(rng, day * 86_400.0, FAST_RAD_S), FAST_RAD_S)
        kept.hear(sound(rng, day * 86_400.0 + 7200.0, FAST_RAD_S), FAST_RAD_S)
        blobs |= kept.state()
    found = heard(blobs)
    assert len(blobs) <= DAYS + 1
    assert found[-1].time_s == (DAYS + 2) * 86_400.0 + 9000.0
    assert len({one.time_s // 86_400.0 for one in found}) >= DAYS
    assert all(a.time_s < b.time_s for a, b in itertools.pairwise(found))


def test_a_small_store_keeps_fewer_days() -> None:
    rng, kept, blobs = np.random.default_rng(5), KeptSound(SETTINGS, 120_000.0), dict[str, bytes]()
    for day in range(30):
        hear_day(kept, rng, day)
        kept.alarm("each day")
        blobs |= kept.state()
    assert sum(len(blob) for blob in blobs.values()) < 120_000
    assert heard(blobs)[0].time_s > 20 * 86_400.0


def test_a_burst_is_kept_at_every_alarm() -> None:
    rng, kept = np.random.default_rng(4), KeptSound(SETTINGS)
    kept.alarm("before any sound")
    blobs, sent = kept.state(), []
    for i in range(BURSTS + 4):
        sent.append(sound(rng, 10.0 * i, FAST_RAD_S))
        kept.hear(sent[-1], FAST_RAD_S)
        kept.alarm(f"alarm {i}")
        kept.alarm("the same sound is not kept twice")
        blobs |= kept.state()
    found = bursts(blobs)
    assert [why for why, _ in found] == [f"alarm {i}" for i in range(4, BURSTS + 4)]
    for (_, got), truth in zip(found, sent[4:], strict=True):
        assert (got.time_s, got.rate_hz) == (truth.time_s, truth.rate_hz)
        np.testing.assert_allclose(got.value, truth.value, atol=1e-4 * float(np.max(np.abs(truth.value))))


def test_what_is_broken_or_unknown_is_left_out() -> None:
    kept = KeptSound(SETTINGS)
    assert not kept.restore(b"no")
    assert not kept.restore(b"")
    kept.hear(Burst("mic", "sound", math.nan, RATE_HZ, np.zeros(SIZE)), 1.0)
    kept.hear(Burst("mic", "sound", 5.0, RATE_HZ, np.full(SIZE, np.nan)), 1.0)
    assert heard(kept.state()) == []
    assert heard({"": b"no", "/3": b"\x93"}) == [] and bursts({"/burst 1": b"no"}) == []
    empty = HourSpectrum(0.0, math.nan, 1.0, np.array([100.0]), np.array([1.0]))
    assert np.isnan(order_level([empty], 2.0)).all()

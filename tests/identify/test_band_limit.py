"""An angle without the noise beside its motion, held against the motion that it was made of."""

import math

import numpy as np
import pytest

from edge_daemon.identify.band_limit import REACH_S, band_limited

RATE_HZ, SECONDS, NOISE = 1000.0, 20.0, 1e-7
TIME_S = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ
INSIDE = (TIME_S > REACH_S) & (TIME_S < SECONDS - REACH_S)


def moving(*tones_hz: float) -> np.ndarray:
    """Tones on a slow sweep that is cut off in the middle of its way: the mirror image at an end has a corner."""
    slow = 0.5 * np.sin(2 * math.pi * 0.37 * TIME_S + 0.4)
    return slow + sum(1e-3 * np.sin(2 * math.pi * f * TIME_S + f) for f in tones_hz)


@pytest.mark.parametrize("second_hz", [36.0, 41.0, 45.0, 49.0, 60.0])
def test_motion_passes_whole_however_far_apart_its_frequencies_are(second_hz: float) -> None:
    """Between 41 and 49 Hz the edges beside the two tones meet."""
    motion = moving(20.0, second_hz)
    noise = np.random.default_rng(1).normal(0.0, NOISE, len(TIME_S))
    found = band_limited(motion + noise, NOISE, RATE_HZ)
    assert np.abs(found.angle - motion)[INSIDE].max() < 5 * NOISE
    left = found.angle[INSIDE] - motion[INSIDE]
    assert float(np.std(left)) == pytest.approx(NOISE * math.sqrt(float(np.mean(found.gain**2))), rel=0.1)


def test_noise_beside_the_motion_is_gone() -> None:
    noise = np.random.default_rng(2).normal(0.0, NOISE, len(TIME_S))
    found = band_limited(moving(20.0) + noise, NOISE, RATE_HZ)
    high = np.fft.rfft((found.angle - moving(20.0))[INSIDE] * np.hanning(int(INSIDE.sum())))
    frequency = np.fft.rfftfreq(int(INSIDE.sum()), 1 / RATE_HZ)
    beside = np.abs(np.fft.rfft(noise[INSIDE] * np.hanning(int(INSIDE.sum()))))
    above = frequency > 60.0
    assert float(np.mean(np.abs(high[above]) ** 2)) < 1e-6 * float(np.mean(beside[above] ** 2))

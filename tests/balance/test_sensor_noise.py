"""The noise of a channel, from numbers drawn with a known sd at instants that are even, uneven or lost."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.balance.sensor_noise import sensor_noise, uneven

SD_RAD = 1e-6


def angle(rate_hz: float, jitter: float, lost: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants, and a fast motion with white noise read at them; `jitter`: sd over the sampling interval."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(20 * rate_hz)) / rate_hz
    time_s = time_s + np.clip(rng.normal(0, jitter, len(time_s)), -0.4, 0.4) / rate_hz
    time_s = time_s[rng.uniform(size=len(time_s)) >= lost]
    moved = 0.3 * np.sin(2 * np.pi * 0.4 * time_s) + 0.02 * np.sin(2 * np.pi * 9 * time_s)
    return time_s, moved + rng.normal(0, SD_RAD, len(time_s))


@pytest.mark.parametrize("jitter", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("lost", [0.0, 0.01])
@pytest.mark.parametrize("rate_hz", [1000.0, 4000.0])
def test_it_is_that_of_the_sensor_however_the_samples_came(rate_hz: float, jitter: float, lost: float) -> None:
    time_s, read = angle(rate_hz, jitter, lost, 17)
    assert uneven(time_s) == (jitter > 0)
    for quantile in (0.5, 0.1):
        assert sensor_noise(time_s, read, quantile) == pytest.approx(SD_RAD, rel=0.1)

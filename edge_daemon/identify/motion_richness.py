"""How rich a motion is: one of few tones ties causes that other motions part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge_daemon.identify.balance import PreparedMotion

RICH_TONES = 2.0
"""With fewer effective tones in the motor speed a motion ties causes that other motions part."""
TONE_WIDTH_HZ = 0.2
TONE_BINS = 4
"""A tone is as wide as the window's main lobe, which counts in a short recording."""


def tones(trials: Sequence[PreparedMotion]) -> float:
    """Effective number of tones, summed over the recordings."""
    return sum(tones_of(trial) for trial in trials)


def tones_of(trial: PreparedMotion) -> float:
    """Effective number of tones in the motor speed: (sum p)^2 / sum p^2 over power in bins of 0.2 Hz or a lobe."""
    speed = np.gradient(trial.motion.theta_in_rad)[trial.rows[0] : trial.rows[-1]]
    power = np.abs(np.fft.rfft((speed - speed.mean()) * np.hanning(len(speed)))) ** 2
    width = max(TONE_BINS, round(TONE_WIDTH_HZ * len(speed) / trial.motion.rate_hz))
    bins = power[: len(power) // width * width].reshape(-1, width).sum(axis=1)
    return float(bins.sum() ** 2 / max(float((bins**2).sum()), 1e-300))

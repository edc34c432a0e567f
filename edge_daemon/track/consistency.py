"""Whether estimates move by as much as their filter says that it learns.

What a Kalman filter takes off its variance with a block is the variance of the step that the block makes (innovations
are white; Bar-Shalom, Li & Kirubarajan, Estimation with applications to tracking and navigation, 2001, section 5.4).
Errors that go on within a second, or that the motion brings back in another guise, make the steps longer: so much
wider are the deviations, amplitude by amplitude, as in the sandwich over blocks of a fit (Liang & Zeger, Biometrika 73,
1986).
"""

from __future__ import annotations

import numpy as np

from edge_daemon.records import Array

WINDOW_S = 1.0
"""Steps are summed over this time, beyond which errors of a torsion are independent: it rings for a tenth of it."""
MEMORY_WINDOWS = 60.0
"""The ratio is that of about the last minute of motion, as the model error is."""
ASSUMED_WINDOWS = 10.0
"""The filter is believed as if so many windows had agreed with it: the ratio of a few is mostly chance (guess)."""
MOST = 1e4
"""One window counts no further than this ratio: a shock is no lasting error (guess)."""


class Consistency:
    """Ratio of the two variances, with forgetting."""

    def __init__(self, amplitudes: int) -> None:
        self._amplitudes = amplitudes
        self.begin()

    def begin(self) -> None:
        """Nothing was seen yet."""
        self._ratio, self._windows = np.ones(self._amplitudes), 0.0
        self._moved, self._learned, self._elapsed_s = np.zeros(self._amplitudes), np.zeros(self._amplitudes), 0.0

    def follow(self, moved: Array, learned: Array, duration_s: float) -> None:
        """(k,) step of each amplitude with a block of `duration_s`, and (k,) variance that the block took off."""
        self._moved += moved
        self._learned += learned
        self._elapsed_s += duration_s
        if self._elapsed_s < WINDOW_S:
            return
        known = self._learned > 0
        ratio = np.minimum(self._moved**2 / np.where(known, self._learned, 1.0), MOST)
        self._windows = min(self._windows + 1.0, MEMORY_WINDOWS)
        self._ratio += np.where(known, ratio - self._ratio, 0.0) / self._windows
        self._moved, self._learned, self._elapsed_s = np.zeros(self._amplitudes), np.zeros(self._amplitudes), 0.0

    @property
    def wider(self) -> Array:
        """(k,) factor on the filter's sd, 1 at the least."""
        believed = (ASSUMED_WINDOWS + self._windows * self._ratio) / (ASSUMED_WINDOWS + self._windows)
        return np.sqrt(np.maximum(believed, 1.0))

"""Whether estimates move by as much as their filter says that it learns.

What a Kalman filter takes off its variance with a block is the variance of the step that the block makes (innovations
are white; Bar-Shalom, Li & Kirubarajan, Estimation with applications to tracking and navigation, 2001, section 5.4).
Errors that go on within a second, or that the motion brings back in another guise, make the steps longer: so much
wider are the deviations, amplitude by amplitude, as in the sandwich over blocks of a fit (Liang & Zeger, Biometrika 73,
1986).
"""

from __future__ import annotations

import math

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


SPANS_S = (1.0, 3.0, 10.0, 30.0)
"""Steps are summed over these times too: what moves quickly shows in the first, what moves slowly in the last."""
DRIFTS = 4.0
"""A sum of steps of this many sd is no chance: one window in sixteen thousand."""
LEAST_GAIN = 0.02
"""A window that tells less than this share of an amplitude's variance says nothing of how far it has moved (guess)."""
GOES_ON_S = 30.0
"""What has moved is expected to go on at the same pace for so long (guess)."""


class Drift:
    """Whether an amplitude itself moves: steps that go on to one side add up beyond what a filter expects of them.

    The sum of the steps of a window has the variance that the window took off (see above). One that is far larger is a
    gear that moves; what is left of its way after the window, step / gain - step, is the doubt that the filter lacks
    (covariance matching over the innovations; Mehra, IEEE Trans. Automatic Control 17, 1972).
    """

    def __init__(self, *spans_s: float) -> None:
        self._spans_s = np.array(spans_s)
        self._moved, self._learned, self._before, self._elapsed_s = np.zeros((4, len(spans_s)))
        self._pace = 0.0
        """variance per second that is expected of what has moved"""

    def follow(self, moved: float, learned: float, variance: float, wider: float, duration_s: float) -> float:
        """Variance that the amplitude lacks, 0 while it keeps still. `moved` and `learned` as above, `variance` before
        the block, and by how much the sd is `wider` for other reasons."""
        self._before[self._elapsed_s == 0.0] = variance
        self._moved += moved
        self._learned += learned
        self._elapsed_s += duration_s
        gain = np.clip(self._learned / np.where(self._before > 0, self._before, np.inf), LEAST_GAIN, 1.0)
        moves = (self._moved**2 > (DRIFTS * wider) ** 2 * self._learned) & (gain > LEAST_GAIN)
        self._pace *= math.exp(-duration_s / GOES_ON_S)
        lacking = self._pace * duration_s
        if moves.any():
            left = np.where(moves, (self._moved * (1.0 / gain - 1.0)) ** 2, 0.0)
            lacking += float(left.max())
            self._pace = max(self._pace, float((left / self._elapsed_s).max()))
        over = (self._elapsed_s >= self._spans_s) | moves.any()
        self._moved[over] = self._learned[over] = self._elapsed_s[over] = 0.0
        return lacking

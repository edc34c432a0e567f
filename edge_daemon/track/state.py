"""What is known of one gear now: amplitudes with their doubt, and what they say of spring, zero and kinematic error."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from edge_daemon.motion.regressors import PP_WAVES, STIFFNESS, AmplitudeKey, Linearisation, Regressors
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array
from edge_daemon.track.recursive import AmplitudeFilter

KNOWN = 5.0
"""A stiffness of this many sd is good enough to refer the kinematic error to."""
COURSE_BLOCKS = 3
"""The peak-to-peak value of the kinematic error is found anew after so many blocks."""


class AmplitudeState:
    """The filter over the amplitudes, the point they are linear around, and how much wider their doubt is."""

    def __init__(self, regressors: Regressors) -> None:
        self.regressors = regressors
        self.forget()

    def forget(self) -> None:
        """Know nothing but the model file."""
        k = len(self.regressors.keys)
        self.filter: AmplitudeFilter | None = None
        self.point: Linearisation | None = None
        self._wider = np.ones(k)
        self.freedom = 1.0
        """independent numbers in what the model lacks, within `recursive.PATTERN_S`"""
        self.sd = np.full(k, math.nan)
        """(k,) standard deviations of the amplitudes, what the model lacks included; NaN before anything is known"""
        self._course, self._course_age = (math.nan, math.nan), 0

    @property
    def wider(self) -> Array:
        """(k,) factor on the filter's sd: what the model lacks does not average out."""
        return self._wider

    @wider.setter
    def wider(self, factor: Array) -> None:
        if self.filter is not None:
            self._wider = factor
            self.sd = self.filter.sd * factor

    def reopen_constant(self) -> None:
        """The encoders' zeros are others now."""
        if self.filter is not None and self.regressors.offset is not None:
            share = np.zeros(len(self.regressors.keys))
            share[self.regressors.offset] = 1.0
            self.filter.forget(share)

    def move_zero(self, by_rad: float) -> None:
        """The twist is counted from elsewhere now. By more than a constant could be, it is another zero altogether."""
        stiffness, offset = self.sure_stiffness(), self.regressors.offset
        if self.filter is None or self.point is None or offset is None or not stiffness > 0:
            return
        if not abs(by_rad) * stiffness < self.filter.scale[offset]:
            return
        moved = np.zeros(len(self.regressors.keys))
        moved[offset] = stiffness * by_rad
        self.filter.rebase(np.eye(len(moved)), moved)
        self.point = replace(self.point, zero_rad=self.point.zero_rad + by_rad)

    def amplitude(self, key: AmplitudeKey) -> tuple[float, float] | None:
        """Value and sd of one amplitude, None when the model lacks it or nothing was learned yet."""
        i = self.regressors.index(*key)
        if i is None or self.filter is None:
            return None
        return float(self.filter.value[i]), float(self.sd[i])

    def sure_stiffness(self) -> float:
        """[N m/rad]; NaN while it is not good enough to refer angles to."""
        stiffness = self.amplitude(STIFFNESS)
        return stiffness[0] if stiffness is not None and stiffness[0] > KNOWN * stiffness[1] else math.nan

    def zero_rad(self, stiffness: float) -> float:
        """Twist that the encoders' zeros hide."""
        offset = self.regressors.offset
        return float(self.filter.value[offset]) / stiffness if self.filter is not None and offset is not None else 0.0

    @property
    def error_rad(self) -> Array:
        """Sine and cosine [rad] of the kinematic error; zeros where there is none to know."""
        point, stiffness = self.point or Linearisation(), self.amplitude(STIFFNESS)
        place = self.regressors.kinematic
        if self.filter is None or stiffness is None or not stiffness[0] > 0 or place.start == place.stop:
            return np.zeros(2 * len(ORDERS))
        return point.whole_error(stiffness[0], self.filter.value[place])

    def felt(self, stretch: Stretch) -> Array:
        """(n,) twist [rad] as the gear feels it: zero and kinematic error put right as far as they are known."""
        stiffness, twist = self.sure_stiffness(), stretch.motion.twist_rad
        if not stiffness > 0:
            return twist
        return np.asarray(twist + stretch.kinematic @ self.error_rad + self.zero_rad(stiffness))

    def felt_rate(self, stretch: Stretch) -> Array:
        """(n,) twist rate [rad/s] as the gear feels it: that of the kinematic error put right as far as it is known."""
        if not self.sure_stiffness() > 0:
            return stretch.motion.twist_rate_rad_s
        return np.asarray(stretch.motion.twist_rate_rad_s + stretch.kinematic_rate @ self.error_rad)

    def spring(self, twist_rad: Array) -> tuple[Array, Array] | None:
        """(n,) torque [N m] of the gear's springs alone at (n,) twists [rad], and its sd; None before one is known."""
        columns, places = self.regressors.springs(twist_rad)
        if self.filter is None or STIFFNESS not in self.regressors.keys:
            return None
        wider = self._wider[places]
        covariance = self.filter.covariance[np.ix_(places, places)] * np.outer(wider, wider)
        variance = np.einsum("ij,jk,ik->i", columns, covariance, columns)
        return columns @ self.filter.value[places], np.sqrt(np.maximum(variance, 0.0))

    def course(self) -> tuple[float, float] | None:
        """Peak to peak of the kinematic error [rad] with sd, every few blocks anew; None where there is none."""
        stiffness, place = self.amplitude(STIFFNESS), self.regressors.kinematic
        if stiffness is None or self.filter is None or place.start == place.stop or not stiffness[0] > 0:
            return None
        if self._course_age == 0:
            self._course = self._peak_to_peak(stiffness[0], self.filter)
        self._course_age = (self._course_age + 1) % COURSE_BLOCKS
        return self._course

    def _peak_to_peak(self, stiffness: float, filt: AmplitudeFilter) -> tuple[float, float]:
        place = self.regressors.kinematic
        course = PP_WAVES @ self.error_rad
        top, bottom = int(course.argmax()), int(course.argmin())
        value, spread = _extreme(course, top) - _extreme(course, bottom), PP_WAVES[top] - PP_WAVES[bottom]
        spread = spread * self._wider[place] / stiffness
        sd = math.sqrt(max(float(spread @ filt.covariance[place, place] @ spread), 0.0))
        return value, sd


def _extreme(course: Array, i: int) -> float:
    """The extreme next to place i of one period, whose first place is its last: of the parabola through three."""
    one_turn = len(course) - 1
    before, here, after = (float(course[(i + j) % one_turn]) for j in (-1, 0, 1))
    bend = before - 2 * here + after
    return here - (after - before) ** 2 / (8 * bend) if bend else here

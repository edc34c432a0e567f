"""What stands against what: the power of motion, torque and columns, and the sensors' noise in all of them.

The encoders' noise is at least what the configuration states; where the angles themselves hold more of it above all
motion, that counts: noise nobody configured would otherwise pass for an effect that the model lacks.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from edge_daemon.motion.kinematics import FirSet
from edge_daemon.motion.noise_level import CLEARLY, NOISE_SLACK, ColumnNoise, Compressed
from edge_daemon.motion.regressors import PROBE_DEGC, EncoderNoise, Regressors, TorqueNoise
from edge_daemon.records import Array, Mask, Motion

EXCITED = 4.0
"""Twist and torque must vary by this many times the variance that sensor noise alone gives them."""
POWER_MEMORY_S = 5.0
"""The power of columns and torque is averaged over this time."""
JITTER_MEMORY = 100.0
"""The encoders' noise is averaged over so many blocks."""
JITTER_CHANCE = 4.2
"""Relative sd of a variance from one sample: of those of a stretch a third are independent (`streaming.JITTER`), and
the quantile makes as much of them as the mean would of 0.37."""
JITTER_AFTER = 10
"""So many blocks pass before it counts, and between updates."""

RECENT_S = 5.0
"""What is longer ago tells nothing of now (guess)."""
MOVED = 0.1
"""By this share of itself may an amplitude move unseen, for another to be mistaken for it (guess: as a gear that is
mended)."""
RIDGE = 1e-12
"""Of an information of unit diagonal, so that amplitudes that are one function of the motion have an inverse."""
UNSURE_SD = 4.0
"""Deviations of the measured speed within which its sign is not known."""
HEARD_SHARE = 0.02
"""The newest noise of a heard motor angle has this share in its average: about as long as the power of motion is
remembered."""


class SensorNoise:
    """Second moments of encoder noise, as configured, or as measured where that is clearly more: the larger of two
    numbers that agree is no better than either, and always too large."""

    def __init__(self, regressors: Regressors, fir: FirSet, sensors: EncoderNoise, torque_measured: bool) -> None:
        self._configured = np.array([sensors.theta_in_rad, sensors.theta_out_rad]) ** 2
        self._regressors, self._torque_measured, self._degC = regressors, torque_measured, PROBE_DEGC
        self._twist = float(fir.value @ fir.value) * np.array([regressors.model.ratio**-2, 1.0])
        self._fir = fir
        self._units = self._of_units()
        self._passes = tuple(float(a @ b) for a, b in ((fir.value, fir.second), (fir.second, fir.second)))
        self._inertia = 0.0 if torque_measured else regressors.model.output_inertia_kg_m2
        self._measured = np.zeros(2)
        self._torque = 0.0
        """variance of the measured torque's own white noise, per sample"""
        self._looked = 0.0
        """samples"""
        self._blocks = self._heard_blocks = 0
        self.sampled_at(fir.rate_hz)

    def sampled_at(self, rate_hz: float) -> None:
        """The rate at which stretches come, for the noise of differences."""
        step = max(1, round(self._fir.rate_hz / rate_hz))
        still = np.zeros(step)
        kernel = np.concatenate((still, self._fir.second, still))
        jerk = (kernel[step:] - kernel[:-step]) * rate_hz * self._inertia
        self._torque_rate = float(jerk @ jerk) if self._inertia else 0.0
        self._apply()

    def _of_units(self) -> list[TorqueNoise]:
        """Of one radian of noise in either encoder."""
        ones = EncoderNoise(1.0, 0.0), EncoderNoise(0.0, 1.0)
        return [self._regressors.noise(self._fir, one, self._torque_measured, self._degC) for one in ones]

    def at(self, temperature_degC: float) -> None:
        """The temperature of the newest block; NaN, or a model without any, changes nothing."""
        if math.isfinite(temperature_degC) and temperature_degC != self._degC and self._regressors.warms:
            self._degC = temperature_degC
            self._units = self._of_units()
            self._apply()

    def follow(self, jitter_rad2: tuple[float, float], torque: float, samples: int) -> None:
        """Take in the variances that a stretch of so many samples showed, of the angles and of a measured torque; NaN
        where it could not."""
        if not math.isfinite(sum(jitter_rad2)):
            return
        self._blocks += 1
        share = 1 / min(self._blocks, JITTER_MEMORY)
        self._measured += (np.array(jitter_rad2) - self._measured) * share
        self._torque += (torque - self._torque) * share if math.isfinite(torque) else 0.0
        self._looked = min(self._blocks, JITTER_MEMORY) * samples
        if self._blocks % JITTER_AFTER == 0:
            self._apply()

    def heard(self, theta_in_rad: float) -> None:
        """The motor angle comes from sound and has this white noise now, sd; NaN changes nothing."""
        if math.isfinite(theta_in_rad):
            self._heard_blocks += 1
            share = max(HEARD_SHARE, 1 / self._heard_blocks)
            self._configured[0] += (theta_in_rad**2 - self._configured[0]) * share
            self._apply()

    def _apply(self) -> None:
        known = self._configured
        if self._looked > 0:
            slack = max(NOISE_SLACK, 1 + CLEARLY * JITTER_CHANCE / math.sqrt(self._looked))
            known = np.where(self._measured > slack * known, self._measured, known)
        into, out = (float(v) for v in known)
        a, b = self._units
        self.torque = TorqueNoise(
            ColumnNoise(
                into * a.inside.columns + out * b.inside.columns, into * a.inside.torque + out * b.inside.torque
            ),
            into * a.torque + out * b.torque + self._torque * float(self._fir.value @ self._fir.value),
        )
        self.twist_rad2 = float(self._twist @ known)
        """of the filtered twist"""
        self.motor_rad2, self.out_rad2 = into, out
        """of each encoder, per sample"""
        self.torque_rate = out * self._torque_rate
        """of the rate of the torque from sample to sample"""

    def slow(self, stiffness: float) -> float:
        """Noise density of the twist less its wind-up J alpha / K at low frequencies, over its mean up to the cut-off:
        what the output's noise makes of the torque takes the more of it the nearer the resonance. 1 without K."""
        if not stiffness > 0 or not self.twist_rad2 > 0:
            return 1.0
        wound, (cross, square) = self._inertia / stiffness, self._passes
        left = self.twist_rad2 + self.out_rad2 * (2 * wound * cross + wound**2 * square)
        return self.twist_rad2 / left

    def dump(self) -> dict[str, Any]:
        """Plain data."""
        told = {"blocks": self._blocks, "looked": self._looked}
        return {"measured": self._measured.tolist(), "torque": self._torque, **told}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave."""
        self._measured, self._blocks = np.array(state["measured"], dtype=float).reshape(2), int(state["blocks"])
        self._looked, self._torque = float(state["looked"]), float(state["torque"])
        self._apply()


class Excitation:
    """Powers over the last seconds."""

    def __init__(self, columns: int, rate_hz: float) -> None:
        self.rate_hz = rate_hz
        self.columns = np.zeros(columns)
        """(k,) mean square of each column"""
        self.torque = 0.0
        self._torque_rate = 0.0

    def follow(self, columns: Array, torque: Array) -> None:
        """(m, k) columns and (n,) torque of a block, each at its own rate."""
        keep = math.exp(-len(torque) / self.rate_hz / POWER_MEMORY_S)
        weight = (1 - keep) / len(torque)
        steps = (torque[1:] - torque[:-1]) * self.rate_hz
        share = (1 - keep) / len(columns)
        self.columns = keep * self.columns + share * np.einsum("ij,ij->j", columns, columns)
        self.torque = keep * self.torque + weight * float(torque @ torque)
        self._torque_rate = keep * self._torque_rate + weight * float(steps @ steps)

    def motion_hz(self, noise: SensorNoise) -> float:
        """Mean frequency of the torque, from the second moment of its spectrum: half as many zero crossings a second
        (Rice, Mathematical analysis of random noise, Bell Syst. Tech. J. 24 (1945), eq. 3.3-11). NaN when unknown."""
        square, level = self._torque_rate - noise.torque_rate, self.torque - noise.torque.torque
        return math.sqrt(max(square, 0.0) / level) / (2 * math.pi) if level > 0 else math.nan

    def dump(self) -> dict[str, Any]:
        """Plain data."""
        return {"columns": self.columns.tolist(), "torque": self.torque, "torque_rate": self._torque_rate}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises ValueError for another number of columns."""
        columns = np.array(state["columns"], dtype=float)
        if columns.shape != self.columns.shape:
            raise ValueError("another number of amplitudes")
        self.columns, self.torque, self._torque_rate = columns, float(state["torque"]), float(state["torque_rate"])


class RecentMotion:
    """What the newest motion alone tells of each amplitude, where all of them may be others than before: what it tells
    nothing of may have changed unseen, whatever was known of it."""

    def __init__(self, amplitudes: int) -> None:
        self._nothing = np.zeros((amplitudes, amplitudes))
        self._told: deque[tuple[float, Array]] = deque()
        """when a block was taken in, and its (k, k) information [1 / units of two amplitudes]"""
        self._now_s = 0.0

    def pass_by(self, duration_s: float) -> None:
        """So much time goes by: what is longer ago than a rest takes to be one is not of now."""
        self._now_s += duration_s
        while self._told and self._now_s - self._told[0][0] > RECENT_S:
            self._told.popleft()

    def add(self, block: Compressed, noise_sd: float, noise: ColumnNoise) -> None:
        """A block whose rows carry white noise of `noise_sd` [unit of the torque]; sensor `noise` in its columns."""
        told = (block.factor.T @ block.factor - block.samples * noise.columns) / noise_sd**2
        self._told.append((self._now_s, told))

    def sd(self, value: Array, doubt: Array, scale: Array) -> Array:
        """(k,) deviations of amplitudes of this `value` and `doubt` that may each have moved by a share of themselves,
        one at a time by as much as its `scale`; infinite where noise outweighs all."""
        free = 1.0 / np.hypot(MOVED * value, doubt) ** 2
        told = sum((row for _, row in self._told), self._nothing)
        whole = told * np.outer(scale, scale) + np.diag(free * scale**2)
        size = np.sqrt(np.maximum(np.abs(whole.diagonal()), 1e-300))
        inverse = np.linalg.inv(whole / np.outer(size, size) + RIDGE * np.eye(len(size))).diagonal() / size**2
        own = 1.0 / np.where(inverse > 0, inverse, math.inf) - free * scale**2
        return np.asarray(scale / np.sqrt(np.where(own > 0, own, 1e-300)))


def is_excited(motion: Motion, good: Mask, noise: SensorNoise, drive: bool) -> bool:
    """Whether torque and twist, or in a `drive` balance the angle, move by more than noise in the `good` samples."""
    if np.count_nonzero(good) < 2:
        return False
    moved = _variance(motion.torque_Nm, good) > EXCITED * noise.torque.torque
    if drive:
        return bool(moved and np.ptp(motion.theta_out_rad[good]) > 0)
    return bool(moved and _variance(motion.twist_rad, good) > EXCITED * noise.twist_rad2)


def one_way(motion: Motion, fir: FirSet, noise: SensorNoise) -> Mask:
    """(n,) where the output surely moves one way within the filter's reach: at rest and near a reversal dry friction
    may have any value up to its level, and the filter spreads that."""
    reach_s = fir.delay / fir.rate_hz
    unsure = UNSURE_SD * math.sqrt(noise.out_rad2 * float(fir.first @ fir.first))
    return np.abs(motion.velocity_out_rad_s) > np.abs(motion.acceleration_out_rad_s2) * reach_s + unsure


def _variance(values: Array, good: Mask) -> float:
    """Of the good ones; a third of the cost of numpy's."""
    values = values if np.count_nonzero(good) == len(good) else values[good]
    off = values - values.sum() / len(values)
    return float(off @ off) / len(values)

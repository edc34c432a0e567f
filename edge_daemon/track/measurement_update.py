"""Taking a block of equations in: which samples are outliers, how noisy it is, whether the gear has changed.

Order of a block: what does the model of a moment ago predict, which samples does that contradict, how noisy are the
others, then the update. A shock passes; what stays is a changed gear, and doubt is given back.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from edge_daemon.motion.excitation import RecentMotion
from edge_daemon.motion.noise_level import ColumnNoise, Compressed, NoiseLevel, compress, widening
from edge_daemon.motion.prediction_error import PredictionError
from edge_daemon.motion.regressors import STIFFNESS, Equation, TorqueNoise
from edge_daemon.records import Array, Mask
from edge_daemon.track.change import SHIFT, ChangeEvidence, StiffnessChange
from edge_daemon.track.consistency import SPANS_S, Drift
from edge_daemon.track.prior import laws_in, prior
from edge_daemon.track.recursive import PATTERN_S, AmplitudeFilter
from edge_daemon.track.state import AmplitudeState
from edge_daemon.track.validity import REFUSED

OUTLIER = 8.0
"""Samples beyond this many sd are left out: an unmodelled friction is bounded by about 2, a glitch is not (guess)."""
SURPRISE = 4.0
"""A block whose innovation has this many times its expected square is left out (chance 1e-4 with nine columns)."""
BREAK_S, WARY_BREAK_S = 1.0, 10.0
"""After this long of nothing but such blocks it is the model that is wrong: doubt is given back. The second where the
readings were wrong themselves a moment ago, and may be so again (guess)."""
CONTRADICTED_S = 0.5
"""Two blocks in a row that contradict are no single event."""
REFUSED_MEMORY_S, WARY_MEMORY_S = 15.0, 2.0
"""The share of refused blocks is averaged over this time, and forgotten within the second where the readings were wrong
a moment ago: what was refused then says little of the model (guess)."""
BREAK_DOUBT = 0.01
"""This share of the prior variance is given back then: a tenth of the prior sd."""
LONG_STEP = 1e-3
"""A block that moves the stiffness by this share of itself is linear around another gear than the next one is."""
MENDED = 0.1
"""A gear that has changed is no other gear: by this share of itself may each amplitude have moved (guess)."""
UNEXPLAINED = 0.2
"""A gear is not mended where this share of the error is no noise, nor was it where that is so afterwards (guess)."""
MENDED_WITHIN_S, MENDS_ONCE_S = 2.5, 10.0
"""Where it is not mended after the first, or contradicts within the second again, all is learned anew (guess)."""
ASTRAY = 2.0
"""A newer stiffness counts no further than this many times one that was good enough to linearise around, or its
reciprocal."""
TELLS_NOTHING = 0.5
"""Doubt of a prediction over the torque, from which on its error says nothing of the model: after a gap or a lost zero
the twist is counted from a place that is yet unknown (guess)."""
NOISE_GUESS = 0.1
"""A model may be wrong by this share of the torque, until the data say how wrong it is."""
SMALLEST_NOISE = 1e-10
"""Noise is at least this share of the torque: noise-free data would otherwise divide by zero."""


WEAR_PER_S = 0.01 / 60.0
"""A stiffness that wears by this share of itself in a second must stay within its deviations before its steps tell that
it moves: a hundredth in a minute (guess: a gear that is being destroyed)."""
LAG_SD = 5.0
"""So many deviations may a filter stay behind such a gear: what is further off than that is called wrong."""
SURE_ENOUGH = 1e-3
"""A stiffness that is known no better than to this share of itself is not made more doubtful for that: a sudden change
must still be told from it."""
REGAINED = 2.0
"""Of the variance that a block took off at most so many times as much comes back (guess)."""


class _Met(NamedTuple):
    """How a compressed block meets what is known before it is taken in."""

    block: Compressed
    innovation: Array
    """(k,) target less what the amplitudes make of it, unit of the torque"""
    spread: Array
    """(k, k) covariance that the doubt of the amplitudes gives it"""
    duration_s: float
    bandwidth: float
    """share of the samples that are independent"""
    held: Array | None
    """(k, s) products of the columns with what the doubt of held shapes makes"""

    @property
    def square(self) -> float:
        """Sum of the innovation's squares."""
        return float(self.innovation @ self.innovation)

    @property
    def doubt(self) -> float:
        """What is expected of that sum from the doubt of the amplitudes alone."""
        return float(np.trace(self.spread))


class MeasurementUpdate:
    """Feeds the filter of what is known."""

    def __init__(self, known: AmplitudeState, drift_per_h: float) -> None:
        """`drift_per_h` is the stiffness's, relative."""
        self._known, self._drift_per_h = known, drift_per_h
        self._drives = known.regressors.model.balance == "drive"
        self._is_stiffness = np.array([key == STIFFNESS for key in known.regressors.keys], dtype=float)
        self._laws = [i for *_, place in laws_in(known.regressors) for i in range(place.start, place.stop)]
        self.errors = PredictionError()
        self.resets = self.mends = 0
        self.wary = False
        """whether the readings were wrong a moment ago"""
        self.changes = 0
        """sudden ones, of the stiffness, so far"""
        self.last_change = 0
        """-1 a loss, 1 a gain"""
        self.start_over()

    def start_over(self) -> None:
        """Know nothing; what was counted so far stays."""
        self.level = NoiseLevel(0.0, pooled=self._drives)
        self.torque_rms = 0.0
        self.recent = RecentMotion(len(self._is_stiffness))
        """what the blocks that were taken in of late tell by themselves"""
        self.elapsed_s = 0.0
        """since the last block that was taken in"""
        self.astray = False
        """what was learned is worth nothing, and must be forgotten"""
        self._change = StiffnessChange()
        self.drift, self.drifts = Drift(*SPANS_S), {i: Drift(0.0, *SPANS_S) for i in self._laws}
        """of the stiffness, and of the laws beside it, for which nothing else watches what changes within a block"""
        self._variance = 0.0
        """of the rows, that a sudden change is held against"""
        self._adequate = False
        """whether the model lacked nothing when a sudden change was last waited for"""
        self._broken_s, self._mended_s = 0.0, math.inf
        self._whole = False
        """whether no sample was missing of the newest block that was refused, or it was not the first"""
        self.refused = 0.0
        """share of the newest blocks that contradict what was learned"""

    @property
    def contradicted(self) -> float:
        """Share of the newest blocks that contradict what was learned; all of them where the very newest does, unless
        a lost zero spoiled samples of it."""
        return 1.0 if self._whole and self._broken_s > 0 else self.refused

    @property
    def is_mending(self) -> bool:
        """Whether a moment ago the gear was found to be another one."""
        return self._mended_s < MENDS_ONCE_S

    @property
    def breaks(self) -> bool:
        """Whether what comes in contradicts what was learned for longer than a single event does."""
        return self._broken_s > CONTRADICTED_S

    def rest(self) -> None:
        """Zeros may have moved: nothing that follows is held for a sudden change until they are known again."""
        self._change.rest()

    def begin(self, equation: Equation, bandwidth: float) -> None:
        """The prior, from a first block."""
        torque, good = equation.torque, equation.good
        self.torque_rms = math.sqrt(float(np.mean(torque[good] ** 2)))
        self.begin_level(bandwidth)
        regressors, drift_per_h = self._known.regressors, self._drift_per_h
        load_power = regressors.gear_load.power_if_all_passed(equation.motion)
        self._known.filter = prior(regressors, equation.columns[good], self.torque_rms, drift_per_h, load_power)

    def begin_level(self, bandwidth: float) -> None:
        """How noisy the rows are is to be found out anew."""
        self.level = NoiseLevel(
            self.level.floor, NOISE_GUESS * self.torque_rms / math.sqrt(bandwidth), pooled=self._drives
        )

    def take(self, equation: Equation, bandwidth: float, settled: bool, predicted: bool) -> Mask | None:
        """(n,) the samples taken in; None when the block was refused. `bandwidth`: share of the samples that are
        independent; `settled`: what was learned so far may judge new data; `predicted`: rows of a prediction."""
        motion, columns, torque, good, _, noise, _ = equation
        self._mended_s += len(motion) / motion.rate_hz
        filt, duration_s = self._known.filter, len(motion) / motion.rate_hz
        assert filt is not None
        if not settled:
            met = _met(filt, equation, good, filt.covariance, bandwidth)
            self._absorb(filt, met, noise, False, predicted)
            return good
        error = torque - columns @ filt.value
        covariance = filt.drifted(self.elapsed_s)
        doubt = np.einsum("ij,ij->i", columns @ covariance, columns)
        if float(doubt.mean()) < TELLS_NOTHING**2 * self._power(torque, good):
            self._remember(equation, error)
        kept: Mask = good & (error**2 < OUTLIER**2 * (self.level.sd**2 * bandwidth + doubt))
        met = _met(filt, equation, kept, covariance, bandwidth)
        if np.count_nonzero(kept) < np.count_nonzero(good) / 2 or self._is_surprised(met):
            met = _met(filt, equation, good, covariance, bandwidth)
            self._whole = bool(equation.usable.all()) or self._broken_s > 0
            self._on_break(filt, met, noise.inside, predicted)
            return None
        self._broken_s = 0.0
        self.refused *= math.exp(-duration_s / (WARY_MEMORY_S if self.wary else REFUSED_MEMORY_S))
        self._absorb(filt, met, noise, True, predicted)
        self.astray = self.astray or (
            MENDED_WITHIN_S < self._mended_s < MENDS_ONCE_S and self.level.structure > UNEXPLAINED
        )
        return kept

    def _power(self, torque: Array, good: Mask) -> float:
        """Mean square of a block's torque [N^2 m^2], or of that of before where the block holds less."""
        return max(float(np.mean(torque[good] ** 2)) if good.any() else 0.0, self.torque_rms**2)

    def _remember(self, equation: Equation, error: Array) -> None:
        """The error (n,) of the model of a moment ago; rows of a prediction are more than samples of the motion."""
        motion, filt = equation.motion, self._known.filter
        assert filt is not None
        every = slice(None, None, max(len(error) // len(motion), 1))
        floor = equation.noise.variance(filt.value)
        self.errors.add(motion, motion.torque_Nm, error[every], equation.good[every], floor)

    def _absorb(self, filt: AmplitudeFilter, met: _Met, noise: TorqueNoise, settled: bool, predicted: bool) -> None:
        value, block, bandwidth = filt.value, met.block, met.bandwidth
        self.level.floor = math.sqrt(noise.variance(self._within_reason(value, noise.inside)) / bandwidth)
        self.level.before(block, bandwidth, met.duration_s)
        self.level.after(met.square, met.doubt, len(met.innovation), predicted)
        if settled and self._changed(filt, met, noise.inside):
            filt.forget(self._is_stiffness * (2 * SHIFT * value / filt.scale) ** 2)
        noise_sd = max(self.level.sd, SMALLEST_NOISE * float(np.linalg.norm(block.target)), sys.float_info.min)
        value = filt.value
        filt.update(block, noise_sd, self.elapsed_s, noise.inside, met.held)
        self.recent.add(block, noise_sd, noise.inside)
        if settled and not self._change.waits:
            self._follow_drift(filt, met, (filt.value - value) / filt.scale, predicted)
        self.elapsed_s = 0.0
        self.astray = not filt.finite

    def _follow_drift(self, filt: AmplitudeFilter, met: _Met, moved: Array, predicted: bool) -> None:
        """Give back what doubt the filter lacks of amplitudes that move; (k,) by how much the block `moved` them, over
        `scale`."""
        i = self._known.regressors.index(*STIFFNESS)
        if i is None or not filt.value[i] > 0:
            return
        filt.drift_by(i, self._drift_per_h / math.sqrt(3600.0) * float(filt.value[i]))  # of a first guess until now
        learned = filt.step[1] * filt.covariance.diagonal() / filt.raw[1].diagonal()  # as if without shrinkage
        share, before, wider = np.zeros(len(learned)), learned + (filt.sd / filt.scale) ** 2, self._known.wider
        for j, drift in {i: self.drift, **self.drifts}.items():
            share[j] = drift.follow(moved[j], learned[j], before[j], wider[j], met.duration_s)
        if filt.sd[i] * wider[i] < SURE_ENOUGH * filt.value[i]:
            wear = WEAR_PER_S * float(filt.value[i] / filt.scale[i]) / (LAG_SD * float(wider[i]))
            share[i] += unnoticed(wear, float(before[i]), float(learned[i]), met.duration_s)
        step = float(moved[i] * filt.scale[i] / filt.value[i])
        if predicted and abs(step) > LONG_STEP:  # linear errs by the square of the step; any column may take that up
            power = np.maximum((met.block.factor**2).sum(axis=0) / met.block.samples, sys.float_info.min)
            most = np.maximum((MENDED * np.abs(filt.value) / filt.scale) ** 2, before)
            share += np.minimum((step**2 * self.torque_rms / filt.scale) ** 2 / power, most)
        if share.any():
            filt.forget(np.minimum(share, 1.0))

    def _within_reason(self, value: Array, noise: ColumnNoise) -> Array:
        """(k,) amplitudes that the sensors' noise is weighed by. After a new start a block or two of coarse angles may
        say anything; noise that followed would be so large that later blocks could not put it right: within a few
        times the stiffness of before, and nothing else may add more noise than the stiffness does."""
        i, point = self._known.regressors.index(*STIFFNESS), self._known.point
        if i is None or point is None or not noise.columns[i, i] > 0:
            return value
        stiffness = min(max(float(value[i]), point.stiffness / ASTRAY), point.stiffness * ASTRAY)
        own = noise.columns.diagonal()
        most = stiffness * np.sqrt(own[i] / np.where(own > 0, own, math.inf))
        bounded = np.where(own > 0, np.clip(value, -most, most), value)
        bounded[i] = stiffness
        return bounded

    def _changed(self, filt: AmplitudeFilter, met: _Met, noise: ColumnNoise) -> bool:
        """A sudden change of stiffness, against the doubt that a missing effect leaves too. Where the model lacked
        nothing when a sum left zero, the noise is at most that of then: what a change leaves in a block must not pass
        for noise. None is told where blocks contradict the model again and again: what it lacks comes and goes."""
        regressors, block = self._known.regressors, met.block
        i = regressors.index(*STIFFNESS)
        if i is None or not filt.value[i] > 0 or self.refused > REFUSED:
            return False
        independent = block.samples * met.bandwidth * max(PATTERN_S / met.duration_s, 1.0)
        wider = float(widening(self.level.structure, independent, self._known.freedom))
        now = (wider * self.level.sd) ** 2 + SMALLEST_NOISE**2
        if self._change.waits and self._adequate:
            now = max(min(now, self._variance), self.level.floor**2)
        elif not self._change.waits:
            self._adequate = self.level.structure == 0.0
        self._variance = variance = now
        column = block.factor[:, i]
        spread = met.spread + variance * np.eye(len(column))
        if (offset := regressors.offset) is not None:  # a softer spring also gives less for the hidden zero
            constant = block.factor[:, offset]
            column = column + constant * (float(filt.value[offset]) / float(filt.value[i]))
            # what the model lacks may be a load that changes slowly
            spread += self.level.structure * self.level.sd**2 * met.bandwidth * np.outer(constant, constant)
        both = np.column_stack((column, met.innovation))
        weighed = both.T @ lapack.dposv(spread, both)[1]
        inside = block.samples * (float(noise.torque[i]) - float(noise.columns[i] @ filt.value)) / variance
        seen = ChangeEvidence(
            score=float(weighed[0, 1]) - inside,
            energy=float(weighed[0, 0]) - block.samples * float(noise.columns[i, i]) / variance,
            square=float(weighed[1, 1]),
            components=len(column),
            duration_s=met.duration_s,
        )
        found = self._change.follow(seen, float(filt.value[i]), float(filt.sd[i]))
        if found:
            self.changes, self.last_change = self.changes + 1, found
        return found != 0

    def _is_surprised(self, met: _Met) -> bool:
        """Whether the columns explain far more of this block than the amplitudes so far do, and their doubt allows for.
        Noise is spread evenly; a pattern that the model lacks may lie all along the columns in one block, and so does
        the noise of an acceleration that is a column itself."""
        k = len(met.innovation)
        along = 1.0 if self._drives else self.level.structure
        freedom = 1.0 + along * met.block.samples * met.bandwidth / k
        spread = met.spread + (freedom * self.level.sd**2 + sys.float_info.min) * np.eye(k)
        return float(met.innovation @ lapack.dposv(spread, met.innovation)[1]) > SURPRISE * k

    def _on_break(self, filt: AmplitudeFilter, met: _Met, noise: ColumnNoise, predicted: bool) -> None:
        """A block that contradicts all before: a shock passes, a changed gear stays, and then the data are right."""
        if not predicted and self._changed(filt, met, noise):
            filt.forget(BREAK_DOUBT * self._is_stiffness)
            self._broken_s = 0.0
            return
        self._broken_s += met.duration_s
        self.refused += (1.0 - self.refused) * (1.0 - math.exp(-met.duration_s / REFUSED_MEMORY_S))
        if self._broken_s < (WARY_BREAK_S if self.wary else BREAK_S):
            return
        if predicted and self._mended_s > MENDS_ONCE_S and self.level.structure < UNEXPLAINED:
            filt.forget((MENDED * filt.value / filt.scale) ** 2)
            self._broken_s = self._mended_s = 0.0
            self.refused = min(self.refused, REFUSED / 2)  # they were of the gear before
            self._change.rest()
            self.mends += 1
            return
        self.astray = predicted  # a prediction around wrong amplitudes leads further astray: the balance first
        if not predicted:
            filt.forget(np.full(len(filt.value), BREAK_DOUBT))
            self.begin_level(met.bandwidth)
            self._broken_s = 0.0
            self._change.rest()
            self.resets += 1


def unnoticed(wear_per_s: float, before: float, learned: float, duration_s: float) -> float:
    """Variance to give back of an amplitude that may move by so many of its deviations per second without a word, where
    a block of `duration_s` took `learned` off the variance `before`.

    One second of data alone has the variance R = P^2 / (dP/dt). A filter that forgets within T has the deviation
    sqrt(R / T) and stays r T behind a ramp r: behind by one deviation where T = (sqrt(R) / r)^(2/3), at a random walk
    of R / T^2 = R^(1/3) r^(4/3) (steady state of a Kalman filter of one state; Bar-Shalom et al., section 5.2).
    """
    if not learned > 0:
        return 0.0
    own = before**2 * duration_s / learned
    return float(min(own ** (1 / 3) * wear_per_s ** (4 / 3) * duration_s, REGAINED * learned))


def _met(filt: AmplitudeFilter, equation: Equation, chosen: Mask, covariance: Array, bandwidth: float) -> _Met:
    """The chosen rows of an equation; copied only where some are left out."""
    rows = chosen if np.count_nonzero(chosen) < len(chosen) else slice(None)
    columns, held, motion = equation.columns[rows], equation.held, equation.motion
    block = compress(columns, equation.torque[rows])
    spread, duration_s = block.factor @ covariance @ block.factor.T, len(motion) / motion.rate_hz
    products = columns.T @ held[rows] if held is not None else None
    return _Met(block, block.target - block.factor @ filt.value, spread, duration_s, bandwidth, products)

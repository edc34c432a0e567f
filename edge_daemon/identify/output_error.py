"""The last step of a torsion fit: the output angle that a model simulates, against the one that was read.

A balance of torques is kept below a cut-off, since accelerations are noisy above; what tells damping and friction
apart lies beyond it, up to the resonance. The error of the simulated angle is white in all of the band and needs no
cut-off: least squares on it attains the Cramer-Rao bound (output error; Ljung 1999, System Identification, ch. 7.4).
It holds only where the model leaves nothing but noise, and is refused elsewhere: the balance bears a wrong law better.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.balance.prepared import Angles, PreparedMotion
from edge_daemon.effects.effect import Effect
from edge_daemon.identify import inloop
from edge_daemon.identify.band_limit import REACH_S, band_limited
from edge_daemon.identify.gauss_newton import ROUGHLY, LoopProblem
from edge_daemon.identify.noise_in_columns import NoiseInColumns
from edge_daemon.identify.regression import RegressionProblem
from edge_daemon.identify.solution import DAMPING, STIFFNESS, Solution, Term
from edge_daemon.identify.structure import LoopBaseline, Place, lawful, spring_of
from edge_daemon.records import Array

Waves = NDArray[np.complex128]

BAND = 0.4
"""The band that is compared ends at this share of the sampling rate, with an edge of this width."""
EDGE = 0.02
LEAST_DAMPING_RATIO = 0.02
"""A search starts from no less damping: with less, the start of the simulation is not forgotten."""
FORGOTTEN = 12.0
"""A simulated angle counts so many time constants after a start or a gap."""
LONGEST_LEAD_S = 2.0
LEAST_S = 5.0
"""At least so much must then be left."""
MOST_SAMPLES = 1_000_000
"""More samples of all trials would take more memory than a gateway has, and tell little more."""
FIRST_ROUNDS, ROUNDS, FAR = 5, 20, 1.6
"""The search goes on after the first of these steps where the error is within so many times the noise."""
SETTLED = 1e-7
"""The search counts as settled below this relative fall of the squared error: a hundredth of a standard deviation."""
FINELY = 4
"""The last simulations take so many steps for one of the first: the midpoint rule bends a resonance of 225 Hz by 1 % at
4 kHz."""
FINEST = 16
"""The finest steps: friction that falls with the rate, of a stiff gear under a 24-bit encoder, was told with 4 ten
standard deviations off."""
BANDS = 30
"""The error is held against the sensors' noise in so many parts of the band up to half the sampling rate."""
WHOLE, IN_PART = 1.2, 1.25
"""The error may be at most so many times that noise, rms: in all, and in any part of the band."""
NOISE_SEED = 0
"""The same recording gives the same fit."""
MOVED_SD = 1.0
"""A number that the same noise once more moves by fewer of its deviations is not moved (guess: it does so by one)."""


@dataclass(frozen=True, slots=True)
class Sharp:
    """What simulated angles say: a point near a solution, how sure it is, and the ratio."""

    point: Array
    """(q,) in the coordinates of the search"""
    sd: Array
    """(q,) of the numbers themselves; nan for one that the angle does not depend on"""
    inflation: Array
    """(q,) of the variance, by what the other numbers do"""
    ratio: tuple[float, float]
    """value and sd"""
    level: float
    """rms error over the sensors' noise"""


@dataclass(frozen=True, slots=True)
class Seen:
    """Of one trial, what the simulated angle is compared with."""

    omega: Array
    """(f,) of the samples' spectrum [rad/s]"""
    input_rad: Array
    """(n,) over the ratio, without the noise beside its motion"""
    input_rad_s: Array
    """its rate"""
    output_rad: Array
    weight: Array
    """(f,) gain that makes the error white and of unit size, zero above the band"""
    rows: NDArray[np.intp]
    """(k,) samples that count"""
    afloat: bool
    """whether the encoders' zeros are unknown: their difference is then fitted beside all else"""


@dataclass(frozen=True, slots=True)
class _Answer:
    """How the linear part of a joint answers, (f,) each."""

    spring: inloop.Spring
    omega: Array
    stiff: Waves
    """torque on the output over its angle, input at rest: K + B s + J s^2"""
    twist: Waves
    """twist over input angle: J s^2 / (K + B s + J s^2)"""

    @classmethod
    def of(cls, spring: inloop.Spring, omega: Array) -> _Answer:
        """The answer at each angular frequency."""
        inert = -spring.inertia * omega**2
        stiff = np.asarray(spring.stiffness + inert + 1j * omega * spring.damping, dtype=np.complex128)
        return cls(spring, omega, stiff, inert / stiff)


def applicable(solution: Solution, problem: RegressionProblem) -> bool:
    """Whether the angles of a structure can be simulated from the input alone: torque by inertia, a spring, and no
    effect that would have to be taken along the noisy twist."""
    if STIFFNESS[0] not in solution.names or not solution.amplitude(*STIFFNESS) > 0:
        return False
    whole = all(trial.angles is not None and trial.sensors.theta_out_rad > 0 for trial in problem.trials)
    if sum(len(trial.motion) for trial in problem.trials) > MOST_SAMPLES:
        return False
    return whole and all(_simulated(term.effect) for term in solution.terms)


def _simulated(effect: Effect) -> bool:
    known = effect.in_loop is not None or effect.is_angle_error or effect.name in (STIFFNESS[0], DAMPING[0])
    return known or not {"twist_rad", "twist_rate_rad_s", "acceleration_out_rad_s2"} & set(effect.needs)


def sharpened(problem: RegressionProblem, solution: Solution) -> Sharp | None:
    """The solution's numbers from simulated angles; None where the model leaves more than noise, or too little is
    left to compare."""
    if not applicable(solution, problem):
        return None
    loop = OutputLoop(problem, solution)
    if not loop.enough:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        base, _ = loop.descend(FIRST_ROUNDS, ROUGHLY)
        if not loop.levels(base)[0] < FAR:
            return None
        loop.finely()
        base, design = loop.descend(ROUNDS, SETTLED)
        base = loop.corrected(base, design)
    if not np.isfinite(design).all() or not np.isfinite(base).all():
        return None
    level, worst = loop.levels(base)
    if level > WHOLE or worst > IN_PART:
        return None
    sharp = loop.sharp(base, design, level)
    return replace(sharp, sd=np.hypot(sharp.sd, _moved_by_noise(problem, solution, loop, sharp.sd)))


def _moved_by_noise(problem: RegressionProblem, solution: Solution, loop: OutputLoop, sd: Array) -> Array:
    """(q,) what the numbers move by with the motor encoder's noise once more, where that is more than `sd` says; 0
    elsewhere. What that noise does of itself is as much (simulation-extrapolation; Cook & Stefanski 1994, JASA 89): a
    law that falls with the rate makes more of it than its weight says, and a bias too."""
    if not lawful(loop.terms):
        return np.zeros(len(sd))
    rng, noisier = np.random.default_rng(NOISE_SEED), copy.copy(problem)
    noisier.trials = tuple(_noisier(trial, rng) for trial in problem.trials)
    again = OutputLoop(noisier, solution)
    again.seen = [replace(new, weight=old.weight) for new, old in zip(again.seen, loop.seen, strict=True)]
    again.point = loop.point.copy()
    again.finely()
    again.corrected(*again.descend(ROUNDS, SETTLED))
    scale = np.array([math.exp(v) if p.index < 0 and p.row.lower > 0 else 1.0 for p, v in loop._named()])
    moved = np.abs(again.point - loop.point) * scale
    return np.where(moved > MOVED_SD * sd, moved, 0.0)


def _noisier(trial: PreparedMotion, rng: np.random.Generator) -> PreparedMotion:
    assert trial.angles is not None
    angle = trial.angles.theta_in_rad
    sd_rad = trial.sensors.theta_in_rad
    angles = replace(trial.angles, theta_in_rad=angle + sd_rad * rng.normal(size=len(angle)))
    return replace(trial, angles=angles, sensors=replace(trial.sensors, theta_in_rad=math.sqrt(2) * sd_rad))


class OutputLoop(LoopProblem):
    """A structure whose target is no error of the output angle, in units of the sensors' noise."""

    def __init__(self, problem: RegressionProblem, solution: Solution) -> None:
        self.times = 1
        """steps of the simulation in each of the balance's"""
        trials = [_trimmed(trial) for trial in problem.trials]
        self.seen = [_seen(trial, solution) for trial in trials]
        pairs = list(zip(trials, self.seen, strict=True))
        angles = copy.copy(problem)
        angles.known = tuple({} for _ in trials)
        angles.trials = tuple(_Unfiltered.of(replace(trial, input_rad_s=seen.input_rad_s)) for trial, seen in pairs)
        angles.target, angles.noise = np.zeros(sum(len(seen.rows) for seen in self.seen)), NoiseInColumns()
        angles.block = np.zeros(len(angles.target), dtype=np.intp)
        super().__init__(angles, solution)
        for j, place in enumerate(self.places):
            if self._name(place) == DAMPING[0]:
                self.point[j] = max(self.point[j], _least_damping(angles.trials[0], solution))

    def _name(self, place: Place) -> str:
        return self.terms[place.term].effect.name

    def finely(self, times: int = FINELY) -> None:
        """From here on, laws are simulated in smaller steps: near the end it is their error that counts."""
        self.times, self._baselines = times, {}

    def corrected(self, base: Array, design: Array) -> Array:
        """(m,) modelled where the finest steps move the point to, by the derivatives (m, q) of the steps before."""
        if not lawful(self.terms):
            return base
        self.finely(FINEST)
        reach = _inverse(design)[0] @ design.T
        bounds = np.array([[self._bound(place, j, side) for j, place in enumerate(self.places)] for side in (-1, 1)])
        base, left = self.modelled(self.point, False)[0], math.inf
        while base @ base < (1 - SETTLED) * left:
            left, before = float(base @ base), self.point
            self.point = np.clip(before - reach @ base, *bounds)
            moved = self.modelled(self.point, False)[0]
            if not moved @ moved < left:
                self.point = before
                break
            base = moved
        self.finely()
        return base

    def _new_baseline(
        self, i: int, trial: PreparedMotion, terms: Sequence[Term], amplitudes: Mapping[str, Array]
    ) -> LoopBaseline:
        baseline = super()._new_baseline(i, trial, terms, amplitudes)
        on = baseline.on
        if not lawful(terms):
            return baseline
        push, load, seen = (inloop.upsampled(signal, self.times) for signal in (on.push, on.load, on.seen))
        fine = inloop.SimulatedTwist(
            on.times * self.times, on.step_s / self.times, push, load, seen, on.start_rate, free=True
        )
        return replace(baseline, on=fine)

    @property
    def enough(self) -> bool:
        """Whether every trial has some seconds to compare."""
        rows = zip(self.seen, self.problem.trials, strict=True)
        return all(len(seen.rows) >= LEAST_S * trial.motion.rate_hz for seen, trial in rows)

    def _modelled(self, i: int, trial: PreparedMotion, point: Array, derive: bool) -> tuple[Array, Array]:
        """(k,) simulated less measured output angle, weighted, and (k, q) its derivative by each number.

        J s^2 x = (K + B s) phi + F with phi = u - x: the linear part exact by its transfer function, the torque F of
        the laws from the simulation, which no observer ties to the noisy twist.
        """
        seen, n = self.seen[i], len(self.seen[i].input_rad)
        terms, amplitudes = self.split(point)
        baseline = self._baseline(i, trial, terms, amplitudes)
        answer = _Answer.of(spring_of(trial, amplitudes), seen.omega)
        extra = self._further(baseline, point)
        held, changes = self._laws(baseline, answer.spring, point, derive)
        lag = fft.rfft(held) if extra is None else fft.rfft(held) + fft.rfft(extra) / answer.stiff
        put_right = baseline.motion.twist_rad - trial.motion.twist_rad
        twist = answer.twist * _spectrum(seen.input_rad + baseline.ahead_rad) - lag
        base = (seen.input_rad - seen.output_rad) + put_right - fft.irfft(twist, n)
        if not derive:
            return self._weighted(seen, base[None])[:, 0], np.empty((len(seen.rows), 0))
        columns = [self._column(j, baseline, answer, changes[j], twist) for j in range(len(self.places))]
        return self._weighted(seen, base[None])[:, 0], self._weighted(seen, np.array(columns))

    def _column(self, j: int, baseline: LoopBaseline, answer: _Answer, change: Waves, twist: Waves) -> Array:
        """(n,) what one number changes of the output angle; `change` of the laws' torque, on a `twist` (f,)."""
        bend, n = baseline.fixed[j], len(baseline.motion)
        if self._name(self.places[j]) == STIFFNESS[0]:
            change = change + twist
        elif self._name(self.places[j]) == DAMPING[0]:
            change = change + 1j * answer.omega * twist
        if bend is None or bend.push is None:
            return fft.irfft(change / answer.stiff, n)
        if bend.twist is None:
            return fft.irfft((change - fft.rfft(bend.push)) / answer.stiff, n)
        if self.terms[self.places[j].term].effect.misreads:
            return bend.twist + fft.irfft(change / answer.stiff, n)
        angle: Array = bend.twist - fft.irfft(answer.twist * _spectrum(bend.twist) - change / answer.stiff, n)
        return angle

    def _laws(self, baseline: LoopBaseline, spring: inloop.Spring, point: Array, derive: bool) -> tuple[Array, Waves]:
        """(n,) angle that the torque of the laws adds, and (q, f) spectrum of what each number changes of it."""
        on, extra = baseline.on, self._further(baseline, point)
        elements = self.elements(*self.split(point))
        if not elements:
            return np.zeros(on.samples), np.zeros((len(self.places), on.samples // 2 + 1), dtype=complex)
        bends = self._bends(point, baseline) if derive else []
        by, changes = inloop.tangent(on, spring, elements, extra, bends)
        answer = _Answer.of(spring, 2 * math.pi * fft.rfftfreq(len(by.torque_Nm), on.step_s))
        angle = fft.irfft(fft.rfft(by.torque_Nm) / answer.stiff, len(by.torque_Nm))[:: on.times]
        return angle, fft.rfft(changes, axis=1)

    @staticmethod
    def _weighted(seen: Seen, signals: Array) -> Array:
        """(k, m) of signals (m, n)."""
        filtered: Array = fft.irfft(fft.rfft(signals, axis=1) * seen.weight, signals.shape[1], axis=1)
        kept = filtered[:, seen.rows].T
        return kept - kept.mean(axis=0) if seen.afloat else kept

    def _powers(self, base: Array) -> list[Array]:
        """Of each trial, (BANDS,) mean square error in parts of the band up to half the sampling rate."""
        cut = np.cumsum([len(seen.rows) for seen in self.seen])[:-1]
        return [_banded(np.abs(fft.rfft(own)) ** 2 / len(own)) for own in np.split(base, cut)]

    def levels(self, base: Array) -> tuple[float, float]:
        """rms error over the sensors' noise: of all, and of the worst part of the band in any trial."""
        inside = np.array(self._powers(base))[:, : int(2 * (BAND - 2 * EDGE) * BANDS)]
        return math.sqrt(float(np.mean(inside))), math.sqrt(float(np.max(inside)))

    def sharp(self, base: Array, design: Array, level: float) -> Sharp:
        """Deviations of the numbers here and of the ratio, whose error a last linear step takes out."""
        covariance, inflation = _inverse(design)
        raw = [math.exp(v) if p.index < 0 and p.row.lower > 0 else 1.0 for p, v in self._named()]
        sd = self._deviations(base, design @ covariance) * np.array(raw)
        sd[~design.any(axis=0)] = math.nan
        return Sharp(self.point, sd, inflation, self._ratio(base, design), level)

    def _ratio(self, base: Array, design: Array) -> tuple[float, float]:
        """Value and sd beside all other numbers and the encoders' zeros."""
        ratio = self.problem.trials[0].motion.ratio
        travel = [seen.output_rad[seen.rows] * seen.weight[0] for seen in self.seen]
        ends = np.repeat(np.arange(len(travel)), [len(part) for part in travel])
        whole = np.column_stack((-np.concatenate(travel) / ratio, np.eye(len(travel))[ends], design))
        influence = whole @ _inverse(whole)[0][:, :1]
        return ratio - float(influence[:, 0] @ base), float(self._deviations(base, influence)[0])

    def _deviations(self, base: Array, influence: Array) -> Array:
        """(q,) sd of influence' @ noise (k, q), of noise with the spectrum that the error has."""
        variance = np.zeros(influence.shape[1])
        cut = np.cumsum([len(seen.rows) for seen in self.seen])[:-1]
        for power, own in zip(self._powers(base), np.split(influence, cut), strict=True):
            waves = np.abs(fft.rfft(own, axis=0)) ** 2 / len(own)
            for level, part in zip(power, np.array_split(waves, BANDS), strict=True):
                variance += 2 * level * part.sum(axis=0)
        deviations: Array = np.sqrt(variance)
        return deviations


def _banded(power: Array) -> Array:
    """(BANDS,) means of a spectrum."""
    return np.array([float(part.mean()) for part in np.array_split(power, BANDS)])


def _inverse(design: Array) -> tuple[Array, Array]:
    """(q, q) inverse of the normal matrix and (q,) variance inflation; 0 for a number that nothing depends on."""
    unseen = ~design.any(axis=0)
    scale = np.linalg.norm(design, axis=0) + unseen
    x = design / scale
    inverse = np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
    inflation = np.diagonal(inverse).copy()
    return inverse / np.outer(scale, scale), inflation


class _Unfiltered(PreparedMotion):
    """A trial whose balance nobody looks at."""

    __slots__ = ()

    @classmethod
    def of(cls, trial: PreparedMotion) -> PreparedMotion:
        """The same trial."""
        return cls(**{field.name: getattr(trial, field.name) for field in fields(trial)})

    def project(self, columns: Array) -> Array:
        """No rows: the filter takes a third of the time."""
        return np.empty((0, columns.shape[1]))


def _trimmed(trial: PreparedMotion) -> PreparedMotion:
    """The trial, at its end shorter by what makes Fourier transforms slow."""
    assert trial.angles is not None
    n = fft.prev_fast_len(len(trial.motion), real=True)
    read = trial.angles
    angles = Angles(read.theta_in_rad[:n], read.theta_out_rad[:n], read.valid[:n])
    kept = trial.rows < n
    return replace(
        trial, motion=trial.motion.between(0, n), angles=angles, rows=trial.rows[kept], block=trial.block[kept],
        target=trial.target[kept], input_rad_s=trial.input_rad_s[:n],
    )  # fmt: skip


def _seen(trial: PreparedMotion, solution: Solution) -> Seen:
    assert trial.angles is not None
    angles, rate = trial.angles, trial.motion.rate_hz
    n, ratio = len(trial.motion), trial.motion.ratio
    omega = 2 * math.pi * fft.rfftfreq(n, 1 / rate)
    into, out = trial.sensors.theta_in_rad / abs(ratio), trial.sensors.theta_out_rad
    spring = spring_of(trial, solution.amplitudes)
    spring = replace(spring, damping=max(spring.damping, _least_damping(trial, solution)))
    gain = np.abs(1 - _Answer.of(spring, omega).twist)
    low = 0.5 - 0.5 * np.tanh((omega * 0.5 / math.pi / rate - BAND) / EDGE)
    motor = band_limited(angles.theta_in_rad / ratio, into, rate)
    weight = low / np.sqrt(out**2 + (gain * into * motor.gain) ** 2)
    lead_s = min(max(FORGOTTEN * 2 * spring.inertia / spring.damping, REACH_S), LONGEST_LEAD_S)
    rows = _forgotten(angles, round(lead_s * rate), round(REACH_S * rate))
    afloat = not any(term.effect.steady for term in solution.terms)  # else the encoders' zeros count as equal
    return Seen(omega, motor.angle, motor.rate, angles.theta_out_rad + trial.zero_rad, weight, rows, afloat)


def _least_damping(trial: PreparedMotion, solution: Solution) -> float:
    spring = spring_of(trial, solution.amplitudes)
    return 2 * LEAST_DAMPING_RATIO * math.sqrt(spring.stiffness * spring.inertia)


def _forgotten(angles: Angles, lead: int, tail: int) -> NDArray[np.intp]:
    """Samples at least `lead` after and `tail` before anything that is not valid."""
    bad = np.concatenate((np.ones(1), ~angles.valid, np.ones(1))).astype(bool)
    at = np.arange(len(bad))
    before = np.maximum.accumulate(np.where(bad, at, -1))
    after = np.minimum.accumulate(np.where(bad, at, len(bad))[::-1])[::-1]
    rows: NDArray[np.intp] = np.flatnonzero((at - before > lead) & (after - at > tail)) - 1
    return rows


def _spectrum(signal: Array) -> Waves:
    """(f,) without the straight line through its ends, to which a joint at rest answers by the same line."""
    spectrum: Waves = fft.rfft(signal - np.linspace(signal[0], signal[-1], len(signal)))
    return spectrum

"""The motor angle from its sound, for a joint without a motor encoder (article 1).

The motor hums at whole orders of its turn. Ratio times output angle is nearly the motor's angle already: what is
missing is the twist. So the sound is brought down to zero frequency by that known angle, and what is left of the
order's phase, over the order, is ratio times twist: slow, small, and without cycles to lose as long as the ratio is
right. A second-order loop keeps the place; its residual, linear in the phase, is what each sample adds, so that the
angle's noise is white and that of the sound itself: density S of the fitted noise model around the line gives each
sample of T seconds the phase variance S / (A^2 T) (Rife & Boorstyn, IEEE Trans. Inf. Theory 20 (1974), for a tone of
amplitude A).

What this is worth: at ratio 100 a phase error of 0.01 rad is 1e-4 rad of twist, all the twist of a stiff joint. Only
averaging over minutes, a high order and a loud line make a stiffness of it; the stated sd says whether they did. An
unknown delay of the sound is a skew of the encoders: leave `encoder_skew` in the model, or state the delay.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from edge_daemon.config.settings import SoundAngle
from edge_daemon.records import Array, Block, Burst, Estimate, Flaw, Status

Complex = NDArray[np.complex128]
NoiseFloorSource = Callable[[Array], Array]
"""(n,) frequencies [Hz] to (n,) density of the noise [unit^2/Hz]"""

LEVEL_S = 1.0
"""Level and phase of each order are averaged over this time."""
CLEAR_SD = 5.0
"""A line counts as heard when it stands this many sd out of the noise in that time."""
LOCKED_RAD = 0.35
"""Above this phase sd the loop may be anywhere: the linear detector ends near half a radian."""
CAPTURE_S = 2.0
"""The loop is locked no sooner than after this much sound."""
SPARE_S = 1.0
"""So much sound is kept beyond what waiting blocks need."""
RIDGE = 1e-4
"""This keeps two orders apart that a short stretch of slow sound cannot tell apart."""
LONGEST_GAP_S = 60.0
"""After this much silence the loop's doubt grows no further: it is lost by then."""
OWN_MEMORY, OWN_AFTER = 100, 20
"""The noise beside the line is averaged over so many blocks, and counts after the second number of them."""
LEAST_SAMPLES = 16
"""Fewer phasors have no spectrum to speak of."""
BAND_POINTS = 16
"""The floor is averaged at so many frequencies over the band of the balance."""


@dataclass(slots=True)
class _Loop:
    """Phase [rad] and its rate [rad/s] that the reference does not explain, with their covariance."""

    bandwidth_hz: float
    phase_rad: float = 0.0
    rate_rad_s: float = 0.0
    covariance: Array = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        self.covariance = np.diag([math.pi**2, (2 * math.pi * self.bandwidth_hz / 10) ** 2])

    def predict(self, dt_s: float, variance_s: float) -> None:
        """White acceleration, of a size that gives the loop its bandwidth on noise of `variance_s` [rad^2 s].

        A steady-state filter of phase and rate has the bandwidth w0 = (q / variance_s)^(1/4), noise bandwidth
        1.06 w0 / 2 one-sided (Kalata, IEEE Trans. AES 20 (1984)).
        """
        move = np.array([[1.0, dt_s], [0.0, 1.0]])
        push = (2 * math.pi * self.bandwidth_hz / 3.3) ** 4 * variance_s
        noise = push * np.array([[dt_s**3 / 3, dt_s**2 / 2], [dt_s**2 / 2, dt_s]])
        self.phase_rad += dt_s * self.rate_rad_s
        self.covariance = move @ self.covariance @ move.T + noise

    def update(self, error_rad: float, variance: float) -> None:
        """Take in the phase error of a block."""
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + variance)
        self.phase_rad += float(gain[0]) * error_rad
        self.rate_rad_s += float(gain[1]) * error_rad
        kept = self.covariance - np.outer(gain, self.covariance[0])
        self.covariance = (kept + kept.T) / 2

    @property
    def sd_rad(self) -> float:
        """Of the phase."""
        return math.sqrt(float(self.covariance[0, 0]))


class MotorFromSound:
    """Blocks and bursts in, blocks with `theta_in_rad` out, in order.

    A block waits until its sound has come, or `wait_s`; samples without sound, below the lowest frequency or before
    the line is heard are MISSING.
    """

    def __init__(
        self, settings: SoundAngle, ratio: float, band_hz: float, floor: Callable[[], NoiseFloorSource | None]
    ) -> None:
        """`band_hz`: of the balance. `floor` gives the noise model, None while there is none."""
        self._settings = settings
        self._ratio = ratio
        self._band_hz = band_hz
        self._floor = floor
        self._orders = tuple(sorted({settings.order, *settings.other_orders}))
        self._waiting: deque[Block] = deque()
        self._sound: deque[Burst] = deque()
        self._forget()
        self.slips = 0
        self._expected_slips = 0.0

    def _forget(self) -> None:
        self._level: Complex = np.zeros(len(self._orders), dtype=np.complex128)
        self._heard_s = 0.0
        self._origin_rad = math.nan
        self._loop = _Loop(self._settings.bandwidth_hz)
        self._followed_s = math.nan
        self.sd_rad = math.nan
        """of the motor angle, each sample, as white noise over the band of the balance; NaN while it is not heard"""
        self.time_s = math.nan
        self._level_sd = math.nan
        self._own = 0.0
        self._own_blocks = 0

    def hear(self, burst: Burst) -> None:
        """Take a stretch of sound; those that hang together are joined."""
        last = self._sound[-1] if self._sound else None
        if last is not None and last.rate_hz == burst.rate_hz:
            late = (burst.time_s - last.time_s) * last.rate_hz - len(last.value)
            if abs(late) < 1.0:
                old = max(0, len(last.value) - math.ceil((self._settings.wait_s + SPARE_S) * last.rate_hz))
                joined = np.concatenate((last.value[old:], burst.value))
                self._sound[-1] = replace(last, time_s=last.time_s + old / last.rate_hz, value=joined)
                return
        self._sound.append(burst)

    def blocks(self, new: tuple[Block, ...]) -> tuple[Block, ...]:
        """The blocks that are complete now."""
        self._waiting.extend(new)
        done: list[Block] = []
        while self._waiting:
            block = self._waiting[0]
            heard_s = max((_end_s(row) for row in self._sound), default=-math.inf) - self._settings.delay_s
            newest_s = self._waiting[-1].end_s
            if heard_s < block.end_s and newest_s - block.end_s < self._settings.wait_s:
                break
            done.append(self._completed(self._waiting.popleft()))
            while self._sound and _end_s(self._sound[0]) < block.start_s + self._settings.delay_s - SPARE_S:
                self._sound.popleft()
        return tuple(done)

    def _completed(self, block: Block) -> Block:
        angle = np.full(block.size, math.nan)
        flaws = np.full(block.size, int(Flaw.MISSING), dtype=np.uint8)
        self.time_s = block.end_s
        out = block.values.get("theta_out_rad")
        if out is not None and block.valid("theta_out_rad").all() and np.isfinite(out).all():
            for burst in self._sound:
                self._listen(block, out, burst, angle, flaws)
        return replace(
            block,
            values={**block.values, "theta_in_rad": angle},
            flaws={**block.flaws, "theta_in_rad": flaws},
        )

    def _listen(self, block: Block, out: Array, burst: Burst, angle: Array, flaws: NDArray[np.uint8]) -> None:
        """Fill in what this burst tells of the block."""
        dt_s = 1 / block.rate_hz
        began_s = burst.time_s - self._settings.delay_s
        inside = (block.time_s - dt_s / 2 >= began_s) & (block.time_s + dt_s / 2 <= began_s + _length_s(burst))
        if inside.sum() < 2:
            return
        rows = slice(int(np.argmax(inside)), int(np.argmax(inside)) + int(inside.sum()))
        first = math.ceil((block.time_s[rows][0] - dt_s / 2 - began_s) * burst.rate_hz - 1e-6)
        last = math.floor((block.time_s[rows][-1] + dt_s / 2 - began_s) * burst.rate_hz + 1e-6)
        value = np.asarray(burst.value[first:last], dtype=float)
        if len(value) < inside.sum() or not np.isfinite(value).all():
            return
        sound_s = began_s + np.arange(first, last) / burst.rate_hz
        reference = self._ratio * _between(sound_s, block, out)
        line_hz = self._settings.order * abs(reference[-1] - reference[0]) / (sound_s[-1] - sound_s[0]) / (2 * math.pi)
        # below half the band the line's own image at twice its frequency would fall into the balance
        if line_hz < max(self._settings.lowest_hz, self._band_hz / 2):
            self.sd_rad = math.nan
            return
        edges = (block.time_s[rows][0] - dt_s / 2) + np.arange(inside.sum() + 1) * dt_s
        phasor, level = self._demodulated(value, reference, sound_s, 1 / burst.rate_hz, edges)
        self._listen_beside(phasor, level, dt_s)
        found = self._followed(phasor, level, edges, self._density(line_hz))
        if found is not None:
            angle[rows] = self._ratio * out[rows] + found / self._settings.order
            flaws[rows] = 0

    def _demodulated(
        self, value: Array, reference: Array, sound_s: Array, step_s: float, edges: Array
    ) -> tuple[Complex, complex]:
        """(m,) the order's phasor, averaged between neighbouring `edges`, and its level before this stretch.

        All orders known so far are taken off first: a neighbour would pass for a kinematic error, and the line's own
        image for motion at twice its frequency.
        """
        turn = np.exp(1j * reference)
        waves = np.stack([turn**order for order in self._orders])
        left = value - (self._level @ waves).real
        share = min(1.0, len(value) * step_s / LEVEL_S)
        share = max(share, 1.0 - self._heard_s / LEVEL_S) if self._heard_s < LEVEL_S else share
        place = self._orders.index(self._settings.order)
        level = complex(self._level[place])
        inner = 2 * left * waves[place].conj()
        running = np.concatenate(([0.0], np.cumsum(inner)))
        at = np.interp(edges, np.append(sound_s, sound_s[-1] + step_s) - step_s / 2, np.arange(len(running)))
        whole = np.clip(at.astype(np.intp), 0, len(inner) - 1)
        cut = running[whole] + (at - whole) * inner[whole]
        phasor = level + np.diff(cut) / np.maximum(np.diff(at), 0.5)
        design = np.concatenate((waves.real, -waves.imag))
        normal = design @ design.T
        normal[np.diag_indices_from(normal)] *= 1 + RIDGE
        moved = np.linalg.solve(normal, design @ left)
        self._level += share * (moved[: len(self._orders)] + 1j * moved[len(self._orders) :])
        self._heard_s += len(value) * step_s
        return phasor, level

    def _listen_beside(self, phasor: Complex, level: complex, dt_s: float) -> None:
        """Follow the noise density in the band of the balance by the part of the phasor that is not phase."""
        if abs(level) == 0.0 or len(phasor) < LEAST_SAMPLES:
            return
        beside = np.abs(phasor)
        if beside.std() > LOCKED_RAD * abs(level):  # the mean of a noisy length is drawn away from zero
            beside = (phasor * level.conjugate()).real / abs(level)
        spectrum = np.abs(np.fft.rfft((beside - beside.mean()) * np.hanning(len(beside)))) ** 2
        last = max(3, round(self._band_hz * dt_s * len(phasor)) + 1)
        density = float(spectrum[2:last].mean()) / float(np.sum(np.hanning(len(beside)) ** 2)) * dt_s
        self._own_blocks += 1
        self._own += (density - self._own) / min(self._own_blocks, OWN_MEMORY)

    def _density(self, line_hz: float) -> float:
        """Noise density around the line that reaches the balance, from both sides over its band.

        The fitted floor to begin with; then what is heard beside the line, since a loud line that moves with the speed
        leads the fit astray. Not above zero, or NaN, where nothing is known.
        """
        if self._own_blocks >= OWN_AFTER:
            return self._own
        floor = self._floor()
        if floor is None:
            return math.nan
        away, lowest = np.linspace(0.0, self._band_hz, BAND_POINTS), self._settings.lowest_hz
        return float(np.mean([floor(np.maximum(np.abs(line_hz + sign * away), lowest)) for sign in (1, -1)]))

    def _followed(self, phasor: Complex, level: complex, edges: Array, density: float) -> Array | None:
        """(m,) phase [rad] between neighbouring `edges`, against where it was first heard; None while it is not."""
        amplitude = abs(level)
        length_s = float(edges[-1] - edges[0])
        dt_s = length_s / len(phasor)
        if self._heard_s < CAPTURE_S or not density > 0 or amplitude < CLEAR_SD * math.sqrt(density / LEVEL_S):
            self.sd_rad = math.nan
            return None
        variance_s = density / amplitude**2
        loop = self._loop
        if math.isnan(self._origin_rad):
            self._origin_rad = loop.phase_rad = math.atan2(level.imag, level.real)
            self._followed_s = float(edges[0])
        loop.predict(min(float(edges[-1]) - self._followed_s, LONGEST_GAP_S), variance_s)
        self._followed_s = float(edges[-1])
        turned = phasor * np.exp(-1j * loop.phase_rad) / amplitude
        mean = complex(turned.mean())
        phase_rad = loop.phase_rad
        loop.update(math.atan2(mean.imag, mean.real), variance_s / length_s)
        self._count_slips(length_s)
        if loop.sd_rad > LOCKED_RAD:
            self.sd_rad = math.nan
            return None
        self.sd_rad = math.sqrt(variance_s / dt_s) / self._settings.order
        self._level_sd = math.sqrt(variance_s / LEVEL_S)
        return np.asarray(phase_rad - self._origin_rad + _detected(turned, variance_s / dt_s))

    def _count_slips(self, length_s: float) -> None:
        """A phase that has gone half a cycle from its place is taken for the next cycle: a lost or gained one.

        Expected: after Viterbi (Principles of Coherent Communication, 1966) a loop of bandwidth B slips once in
        pi^2 r I0(r)^2 / (2 B) seconds, r the inverse of its phase variance.
        """
        loop = self._loop
        away = loop.phase_rad - self._origin_rad
        cycles = round(away / (2 * math.pi))
        if cycles:
            loop.phase_rad -= 2 * math.pi * cycles
            self.slips += abs(cycles)
        r = 1 / loop.sd_rad**2
        log_bessel = math.log(float(ive(0, r))) + r
        log_mean_s = math.log(math.pi**2 * r / (2 * self._settings.bandwidth_hz)) + 2 * log_bessel
        self._expected_slips += length_s * math.exp(-min(log_mean_s, 700.0))

    def estimates(self) -> tuple[Estimate, Estimate]:
        """`sound_angle_sd` and `sound_angle_slips`; the sd of the latter is that of the number chance would make."""
        heard = math.isfinite(self.sd_rad)
        status = Status.VALID if heard else Status.INVALID
        if not heard and self._heard_s < CAPTURE_S:
            status = Status.WARMING_UP
        return (
            Estimate("sound_angle_sd", self.sd_rad, self._level_sd * self.sd_rad, "rad", status, self.time_s),
            Estimate("sound_angle_slips", float(self.slips), math.sqrt(self._expected_slips), "1", status, self.time_s),
        )


def _detected(turned: Complex, variance: float) -> Array:
    """(m,) phase errors. The angle where the noise lets it be told; else the part that is linear in the phase, since
    the mean of a noisy angle is drawn towards zero."""
    return np.angle(turned) if variance < LOCKED_RAD**2 else np.asarray(turned.imag)


def _length_s(burst: Burst) -> float:
    return len(burst.value) / burst.rate_hz


def _end_s(burst: Burst) -> float:
    return burst.time_s + _length_s(burst)


def _between(sound_s: Array, block: Block, out: Array) -> Array:
    """The output angle at the sound's instants: parabolas between samples, and on beyond the first and last.

    A straight line between samples errs with the acceleration, and so with the twist.
    """
    place = (sound_s - block.start_s) * block.rate_hz
    left = np.clip(place.astype(np.intp), 0, len(out) - 2)
    share = place - left
    bend = np.zeros(len(out))
    bend[1:-1] = np.diff(out, 2)
    bend[0], bend[-1] = bend[1], bend[-2]
    curved = (1 - share) * bend[left] + share * bend[left + 1]
    return np.asarray(out[left] + share * (out[left + 1] - out[left]) - 0.5 * share * (1 - share) * curved)

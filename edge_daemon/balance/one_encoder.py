"""What a balance with one encoder needs beside the other: a filter under which its noise is white, and reversals.

Angles are differentiated twice: their noise stands in inertia times acceleration and grows with the square of the
frequency, that of a measured speed with the frequency, while that of the torque is white. Both sides pass a filter
under which the sum of them is white (generalised least squares; Aitken 1936), so that each row counts for what it is
worth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from edge_daemon.balance.motion_noise import MotionNoise, share_by_speed
from edge_daemon.balance.sensor_noise import NoiseOfSensors
from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.motion.excitation import UNSURE_SD
from edge_daemon.motion.kinematics import FirSet, filters, spread_invalid
from edge_daemon.motion.left_over import NEGLIGIBLE, LeftOver
from edge_daemon.records import Array, Mask, Motion

ROUGH_HZ = 15.0
"""Cut-off of the first look at the inertia: low enough that an encoder's noise does not matter, above most motion."""
ROUGH_SHARE = 0.1
"""The same over the sampling rate, where that is low."""
LEAST_WHITE_HZ = 4.0
"""Lowest frequency from which encoder noise may count for more than the torque's: slower motion is no noise."""
TAIL = 6.0
"""Length of a whitening kernel in its time constants: what is left is 2.5e-3."""
TRANSFORM = 1 << 15
"""Samples over which the gain of a whitening filter is laid out."""
TRUSTED_SD = 3.0
"""Standard deviations from zero from which the rough inertia is used."""
STEADY = 0.1
"""Scatter of a speed over its mean below which it is one, and what accelerates the shaft is its own ripple (guess: 0.02
to 0.04 in a robot's logs of one speed each, 0.3 in those of a press)."""
ODD_PIECE_S = 0.25
"""Length of the pieces among which a stretch is looked for that holds most of the error."""
ODD_TIMES, ODD_SHARE, ODD_LENGTH = 20.0, 0.5, 0.05
"""Power of such a piece over the median, share of all squared error, and largest share of the recording (guesses: a
stop held 74 % in half a second of a minute; a law that is missing shows all along the motion)."""
MOST_ODD, QUIET = 3, 0.25
"""Such stretches at the most, and power over theirs where the output passes there again, of each of several (guesses: a
robot is bumped into once or twice, while a law that is missing shows at every reversal, or whenever it comes there)."""
FASTER = 1.25
"""Top speed within such a stretch over that elsewhere beyond which it is none: what a law does there nothing else tells
(guess: bumps and brakes came at the speeds of the rest, a move at twice those showed a crank's own inertia)."""
LEAST_ARGUMENT_HZ = 6.0
"""Lowest cut-off of the motion: below it an arm's own motion would go."""
SURE_SPEED_SHARE = 0.1
"""Speed over its rms whose sign must be seen."""
PLAYED = 0.1
"""Inertia beside any load by the angle over that beside a weight and a known load below which the motor plays a spring,
so that its own torque is that load (guess: 0.02 of a haptic handle)."""
LOAD_KNOTS, OTHER_LOAD = 10, 0.5
"""Places between which a load of any form by the angle is straight in a first look, and its squared error over that of
a weight below which it is no weight (guesses)."""
USUAL_SPEED_S = 0.1
"""Time over which the usual speed is taken."""
STANDSTILL_SHARE = 0.03
"""A single-encoder drive counts as standing below this share of its rms speed."""
RECKONED = 1e-4
"""Correlation of a torque behind the gear with the motor's, below one, up to which it was reckoned from that (guess:
friction of a seventieth)."""
OFF_S, OFF_RAD = 0.5, 0.02
"""A torque that is nought for so long while the output moves so far is none (guesses)."""
LONGEST_BRIDGE_S = 0.15
"""Longest gap over which an arm's motion is bridged in a drive balance."""
BESIDE_GAP_S = 0.01
"""On either side of a gap that bends the motion by more than noise, what is left out besides."""
BRIDGED_SD = 3.0
"""Noise of the angle, in standard deviations, that the error of a bridge may reach (guess)."""


def seen_at_output(columns: Mapping[str, Array], ratio: float) -> Mapping[str, Array]:
    """The columns with the output's angle: that of the motor over the ratio where only the motor has an encoder; with
    the motor's torque in the direction of the output, which turns against the motor where the ratio is below 0; and
    with the torque that passes the gear where a sensor behind it measured that, unless the controller's is there. The
    sensor's own column goes: where one is, it is taken for the torque of a twist."""
    more = {name: -columns[name] for name in MOTOR_TORQUES if name in columns and ratio < 0.0}
    if "theta_out_rad" not in columns and "theta_in_rad" in columns:
        more["theta_out_rad"] = columns["theta_in_rad"] / ratio
    if measures_load(columns):
        more["torque_model_Nm"] = columns["torque_out_Nm"]
    return {name: column for name, column in columns.items() if name != "torque_out_Nm"} | more


def measures_load(columns: Mapping[str, Array]) -> bool:
    """Whether a torque sensor behind the gear stands in for the controller's model torque: there is one, it tells more
    than a number, and something else than the motor's torque, from which some drives reckon it."""
    if "torque_model_Nm" in columns or "torque_out_Nm" not in columns:
        return False
    motor = next((columns[name] for name in MOTOR_TORQUES if name in columns), None)
    rows = [columns["torque_out_Nm"], *(() if motor is None else (motor,))]
    known = np.stack(rows)[:, np.isfinite(rows).all(axis=0)]
    if not known.size or not np.ptp(known[0]):
        return False
    return motor is None or not np.ptp(known[1]) or 1.0 - abs(float(np.corrcoef(known)[0, 1])) > RECKONED


def while_powered(time_s: Array, columns: Mapping[str, Array]) -> tuple[Mapping[str, Array], tuple[str, ...]]:
    """The columns without what was recorded while the drive was switched off, and the line that says so: its torque is
    nought to the last bit for long, and the joint is moved, as friction never lets it be, or its angle leaps."""
    name = next((name for name in MOTOR_TORQUES if name in columns), None)
    if name is None:
        return columns, ()
    edges = np.flatnonzero(np.diff(np.concatenate(([False], columns[name] == 0.0, [False])).astype(int)))
    angle, torque = (np.array(columns[key], dtype=float) for key in ("theta_out_rad", name))
    off_s = []
    for start, stop in edges.reshape(-1, 2):
        if time_s[stop - 1] - time_s[start] < OFF_S:
            continue
        whole = columns["theta_out_rad"][max(start - 1, 0) : stop + 1]
        leaps = np.abs(np.diff(whole))[[0, -1]].max() > OFF_RAD
        if leaps or np.nanmax(whole, initial=-np.inf) - np.nanmin(whole, initial=np.inf) > OFF_RAD:
            torque[start:stop] = math.nan
            angle[start:stop] = math.nan if leaps else angle[start:stop]
            off_s.append((time_s[start], time_s[stop - 1]))
    if not off_s or not np.isfinite(torque).any():
        return columns, ()
    stretch = f"from {off_s[0][0]:.5g} to {off_s[0][1]:.5g} s" + (" and elsewhere" if len(off_s) > 1 else "")
    told = f"{name} is 0 {stretch} while the joint is moved: switched off, and left out"
    return {**columns, "theta_out_rad": angle, name: torque}, (told,)


@dataclass(frozen=True, slots=True)
class Doubts:
    """What a drive with one encoder leaves in doubt."""

    valid: Mask
    unsure: Mask
    """samples whose friction has a sign that nobody knows"""
    fir: FirSet
    """the balance filter under which the noise of torque and acceleration is white together"""
    inertia: float
    turned: FirSet
    """the filter of the angle and its derivatives"""
    remarks: tuple[str, ...]
    """of the stretches that are judged without"""


def doubts_of(
    whole: Mask,
    motion: Motion,
    sensors: NoiseOfSensors,
    noise: MotionNoise,
    fir: FirSet,
    argument_hz: float,
    angle_rad: Array,
    all_of_it: bool = False,
) -> Doubts:
    """What is not known of a recording, `whole` outside its gaps, whose motion has the cut-off `argument_hz`, for a
    balance filtered by `fir`; `angle_rad` (n,) as measured. `all_of_it`: with the stretches that a first look cannot
    tell."""
    turned = filters(motion.rate_hz, argument_hz)
    told = math.isfinite(noise.speed_rad_s)
    unsure = turning(motion, noise.speed_sd(turned) * (1.0 if told else share_by_speed(angle_rad, motion, turned)))
    gaps, long = _gaps(~whole, motion, noise)
    valid = spread_invalid(~long, turned.delay)
    kept, rough, remarks = without_odd(motion, valid & ~unsure & ~gaps)
    white = whitening(fir, noise, rough.inertia, sensors.torque)
    if all_of_it:
        return Doubts(valid, unsure | gaps, white, rough.inertia, turned, ())
    return Doubts(valid & kept, unsure | gaps, white, rough.inertia, turned, remarks)


def _gaps(lost: Mask, motion: Motion, noise: MotionNoise) -> tuple[Mask, Mask]:
    """(n,) samples in gaps, where the torque is unknown, and those in gaps that are too long to be bridged.

    A straight bridge errs by an eighth of the acceleration times the gap squared: where that is more than the sensor's
    noise, the motion beside the gap is not known either.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], lost, [False])).astype(int)))
    gaps, long = np.zeros(len(lost), dtype=bool), np.zeros(len(lost), dtype=bool)
    bent = math.sqrt(float(np.nanmean(motion.acceleration_out_rad_s2**2)))
    for start, stop in edges.reshape(-1, 2):
        span_s = (stop - start + 1) / motion.rate_hz
        seen = bent * span_s**2 / 8 <= BRIDGED_SD * noise.angle_rad or math.isfinite(noise.speed_rad_s)
        beside = 0 if seen else round(BESIDE_GAP_S * motion.rate_hz)
        gaps[max(start - beside, 0) : stop + beside] = True
        long[start:stop] = span_s > LONGEST_BRIDGE_S
    return gaps, long


def turning(motion: Motion, speed_sd: float | Array) -> Mask:
    """Samples at standstill or near it, where friction takes any value up to its level: no law of the speed holds, or
    its sign is not seen."""
    speed = np.abs(motion.velocity_out_rad_s)
    least = np.maximum(STANDSTILL_SHARE * math.sqrt(float(np.mean(speed**2))), UNSURE_SD * speed_sd)
    near = speed <= least
    crossed = np.flatnonzero(np.diff(np.sign(motion.velocity_out_rad_s)) != 0)
    near[crossed] = near[np.minimum(crossed + 1, len(near) - 1)] = True
    return near


@dataclass(frozen=True, slots=True)
class RoughFit:
    """A first look at a drive: torque by inertia, friction, weight, a constant and the controller's model torque."""

    inertia: float
    """torque per acceleration; 0 where none is seen"""
    left: Array
    """(n,) what it leaves of the torque; NaN where nothing is known"""


def rough_fit(motion: Motion, valid: Mask) -> RoughFit:
    """The first look at one recording, at low frequencies, with the controller's model torque where there is one: what
    that holds of the inertia is no noise. Where some load by the angle leaves much less than a weight, the inertia is
    that beside such a load, unless the motor plays one; where load and inertia are one function of the motion, as in a
    single sine, that of a fit without: its size is all that noise asks for. At one speed there is none to be told."""
    more = [motion.extra[name] for name in ("torque_model_Nm",) if name in motion.extra]
    fir = filters(motion.rate_hz, min(ROUGH_HZ, ROUGH_SHARE * motion.rate_hz))
    speed, angle = motion.velocity_out_rad_s, motion.theta_out_rad
    rows = [motion.acceleration_out_rad_s2, speed, np.sign(speed), np.ones(len(motion)), *more]
    weight = [np.sin(angle), np.cos(angle)]
    x = fir.apply(fir.value, np.stack([*rows, *weight, motion.torque_Nm], axis=1))
    known = valid & np.isfinite(x).all(axis=1)
    seen, y = x[known, :-1], x[known, -1]
    left = np.full(len(motion), math.nan)
    if len(seen) <= fir.step * (seen.shape[1] + 1):
        return RoughFit(0.0, left)
    left[known] = y - seen @ np.linalg.lstsq(seen[:: fir.step], y[:: fir.step], rcond=1e-10)[0]
    x, y = seen[:: fir.step], y[:: fir.step]
    if np.std(x[:, 1]) < STEADY * abs(np.mean(x[:, 1])):
        return RoughFit(0.0, left)
    any_load = np.column_stack((x[:, :3], x[:, 4 : len(rows)], _hats(angle[known][:: fir.step])))
    (inertia, square), (beside, least) = _first_known(x, y), _first_known(any_load, y)
    told = beside if beside > 0.0 and (least < OTHER_LOAD * square or not inertia > 0.0) else max(inertia, 0.0)
    if more and told < PLAYED * inertia:
        told = inertia
    return RoughFit(told or abs(_first_known(x[:, : len(rows)], y)[0]), left)


def _hats(angle: Array) -> Array:
    """(m, k) columns of which any curve over the angle (m,) is made, straight between some places."""
    knots = np.unique(np.quantile(angle, np.linspace(0, 1, LOAD_KNOTS)))
    return np.stack([np.interp(angle, knots, row) for row in np.eye(len(knots))], axis=1)


def _first_known(x: Array, y: Array) -> tuple[float, float]:
    """The first of the amplitudes of columns x, if it is sure, else 0; and the squared error that is left. Others may
    be alike, as the sign of the speed and a constant are on a shaft that turns one way."""
    left, own = (LeftOver.of(row, x[:, 1:]).signal for row in (y, x[:, 0]))
    alone, freedom = float(own @ own), len(x) - x.shape[1]
    if freedom <= 0 or not math.sqrt(alone) > NEGLIGIBLE * float(np.linalg.norm(x[:, 0])):
        return 0.0, math.inf
    found = float(own @ left) / alone
    square = float(np.sum((left - found * own) ** 2))
    return (found if abs(found) > TRUSTED_SD * math.sqrt(square / freedom / alone) else 0.0), square


def odd_stretches(left: Array, rate_hz: float) -> list[tuple[int, int]]:
    """First and last sample of each of the fewest short stretches that hold most of the squared error of a first look;
    empty where it takes many.

    A stop that is run into, a brake that falls in or a push by a person is no law of the gear: it would rule every
    verdict.
    """
    size = max(1, round(ODD_PIECE_S * rate_hz))
    power = np.nan_to_num(left) ** 2
    pieces = np.add.reduceat(power, np.arange(0, len(power), size))
    whole = float(pieces.sum())
    loud = np.flatnonzero(pieces > ODD_TIMES * np.median(pieces[pieces > 0])) if whole else np.empty(0)
    if not len(loud):
        return []
    runs = np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1)
    runs = sorted(runs, key=lambda run: -float(pieces[run].sum()))[:MOST_ODD]
    shares = np.cumsum([float(pieces[run].sum()) / whole for run in runs])
    fewest = runs[: int(np.argmax(shares >= ODD_SHARE)) + 1]
    if shares[-1] < ODD_SHARE or max(map(len, fewest)) > ODD_LENGTH * len(pieces):
        return []
    return [(int(run[0]) * size, min(int(run[-1] + 1) * size, len(left)) - 1) for run in fewest]


def joined(places: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches in order, those that touch as one."""
    out = list[tuple[int, int]]()
    for begin, end in sorted(places):
        if out and begin <= out[-1][1] + 1:
            out[-1] = out[-1][0], max(out[-1][1], end)
        else:
            out.append((begin, end))
    return out


def outside(places: list[tuple[int, int]], count: int) -> Mask:
    """(count,) the samples that lie in none of some stretches."""
    out = np.ones(count, dtype=bool)
    for begin, end in places:
        out[begin : end + 1] = False
    return out


def without_odd(motion: Motion, known: Mask) -> tuple[Mask, RoughFit, tuple[str, ...]]:
    """(n,) the samples of a recording that are judged, a first look at them as far as they are `known` (n,), and what
    is said of the stretches that are not: one that is louder than all else may hide another."""
    places, kept, first = list[tuple[int, int]](), np.ones(len(known), dtype=bool), rough_fit(motion, known)
    rough = first
    while more := odd_stretches(rough.left, motion.rate_hz):
        together = joined([*places, *more])
        events = len(together) == 1 or all(_passed(motion, rough.left, row, together) for row in more)
        events &= not any(_fastest(motion, row, together) for row in more)
        if len(together) > MOST_ODD or not events:
            break
        places, kept = together, outside(together, len(known))
        rough = rough_fit(motion, known & kept)
    if not places:
        return kept, rough, ()
    share = 1.0 - float(np.nansum(rough.left**2) / np.nansum(first.left**2))
    spans = [f"{motion.time_s[begin]:.5g} to {motion.time_s[end]:.5g} s" for begin, end in places]
    return kept, rough, (f"{', '.join(spans)}: {share:.0%} of the squared error: judged without",)


def _passed(motion: Motion, left: Array, place: tuple[int, int], places: list[tuple[int, int]]) -> bool:
    """Whether the output passed the middle of one of some stretches another time, quietly: what it meets whenever it
    comes there is a law of the gear."""
    rows, angle = slice(place[0], place[1] + 1), motion.theta_out_rad
    power = np.nan_to_num(left[rows]) ** 2
    middle = float(np.average(angle[rows], weights=power))
    width = math.sqrt(float(np.average((angle[rows] - middle) ** 2, weights=power)))
    other = (np.abs(angle - middle) <= width) & np.isfinite(left) & outside(places, len(left))
    return bool(other.any()) and float(np.mean(left[other] ** 2)) < QUIET * float(power.mean())


def _fastest(motion: Motion, place: tuple[int, int], places: list[tuple[int, int]]) -> bool:
    """Whether the output was faster in one of some stretches than anywhere outside them."""
    speed = np.abs(np.nan_to_num(motion.velocity_out_rad_s))
    return float(speed[place[0] : place[1] + 1].max()) > FASTER * float(
        speed[outside(places, len(speed))].max(initial=0.0)
    )


def motion_cutoff_hz(time_s: Array, angle: Array, noise: MotionNoise, most_hz: float) -> float:
    """Cut-off of the motion at which noise hides the sign of a tenth of its speed."""
    usual = usual_speed(time_s, angle, 1 / noise.rate_hz)
    return noise.cutoff_hz(SURE_SPEED_SHARE * usual / UNSURE_SD, min(LEAST_ARGUMENT_HZ, most_hz), most_hz)


def usual_speed(time_s: Array, angle: Array, sample_s: float) -> float:
    """rms speed over a tenth of a second, of which an encoder's step is a small part."""
    stride = max(1, round(USUAL_SPEED_S / sample_s))
    moved = (angle[stride:] - angle[:-stride]) / (time_s[stride:] - time_s[:-stride])
    return math.sqrt(float(np.nanmean(moved**2))) if len(moved) else 0.0


def whitening(fir: FirSet, noise: MotionNoise, inertia: float, torque_noise: float) -> FirSet:
    """The filter under which the noise of the torque and that of inertia times acceleration are white together; as it
    is where that changes little."""
    frequency = np.asarray(np.fft.rfftfreq(TRANSFORM, 1 / fir.rate_hz), dtype=float)
    over = inertia**2 * noise.acceleration_power(frequency) / max(torque_noise**2, 1e-300)
    above = np.flatnonzero(over > 1)
    if not len(above) or not (corner_hz := max(float(frequency[above[0]]), LEAST_WHITE_HZ)) < fir.cutoff_hz:
        return fir
    over /= max(float(np.interp(LEAST_WHITE_HZ, frequency, over)), 1.0)
    response = np.fft.irfft(1 / np.sqrt(1 + over))
    half = math.ceil(TAIL * math.sqrt(2) * fir.rate_hz / (2 * math.pi * corner_hz))
    bent = np.concatenate((response[-half:], response[: half + 1]))
    value = np.convolve(fir.value, bent)
    return replace(fir, value=value / value.sum())

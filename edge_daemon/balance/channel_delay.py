"""A current or a speed that was read later or earlier than the angle, as loggers and filters make it: taken out.

A delay d of the torque leaves d dtau/dt: of a weight a drag that turns with the angle, of the inertia a jerk, of ripple
a turned phase. The likelihood of a delay is that of what a first look at the drive leaves of the shifted torque, with
friction of every form among its columns; its curvature over independent samples is the delay's standard deviation.
Reversals, where a joint that stands still is pushed before it moves, are left out as everywhere in this balance.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from edge_daemon.balance.drive_columns import drive_columns, waves_beside
from edge_daemon.balance.motion_noise import SPEED
from edge_daemon.balance.preparation import prepare
from edge_daemon.balance.prepared import BLOCK_S, PreparedMotion
from edge_daemon.balance.reversals import unknown_directions
from edge_daemon.channels import MOTOR_TORQUES
from edge_daemon.effects.algebra import followed
from edge_daemon.effects.model import Model
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.residual_statistics import independent
from edge_daemon.records import Array, Mask, Recorded

LONGEST_S, STEP_S = 0.02, 0.5e-3
DELAYS_S = np.arange(-LONGEST_S, LONGEST_S + STEP_S / 2, STEP_S)
"""Delays are looked for up to the former, in steps of the latter: beyond it no robot's log is of one instant."""
LEAST_S, SURE_SD, LEAST_FALL, APART_S = 2e-3, 5.0, 0.05, 1e-3
"""A delay is believed from this length, so many standard deviations and such a share of the squared error that it
takes, where the halves of a recording, its slow part alone, and all of it without the controller's model torque, if
that is explained too, differ by no more than the last: a law that is missing has none of its own, ripple that no column
holds only a fast one, and a model torque has a delay of its own, by which it may take the inertia's place (guesses; on
simulated joints it seemed 0.9 ms at the most, and on real ones halves agreed to 0.7 ms or not at all)."""
SLOW_HZ, SLOW_SHARE = 8.0, 0.06
"""Cut-off of that slow part, also over the sampling rate: true delays agreed there to 0.4 ms, and what ripple of other
orders seemed to be, 2 to 9 ms, fell to 0.1 or 7 ms."""
SLOWEST_SPEED_S, SPEED_STEP_S = 0.06, 1e-3
"""The same of a recorded speed, whose filter may be as slow as a motion allows (3 Hz)."""
SPEED_DELAYS_S = np.arange(-SLOWEST_SPEED_S, SLOWEST_SPEED_S + SPEED_STEP_S / 2, SPEED_STEP_S)
MODELLED = "torque_model_Nm"
BENT_TIMES = 1.25
"""What a first look leaves with a late speed over what it leaves without, from which on the speed's filter has bent it
as well as delayed it (guess: 1.02 to 1.14 behind filters above the motion, 1.4 to 3 behind slower ones)."""
LEAST_KNOWN_S, APART_KNOWN_S, KNOWN_FLOORS = 2e-4, 3e-4, 2.0
"""Beside a model that leaves no more than so many noise floors a delay is believed from the first, where the halves of
a recording differ by no more than the second: no law is missing there that could pass for it (guess)."""
NOTHING_ELSE_FLOORS = 1.15
"""What a model leaves with a delay, over noise, up to which the model alone tells it, if a first look has it the same
way: so many columns as that is made of take much of a delay in a short recording (guess: exact models leave up to 1.1).
"""
MOST_FALL = 0.6
"""The same of one that takes this share of the squared error, whatever is left: late currents of simulated joints took
0.7 to 0.99 of it (guess)."""
APART_SD, UNTOLD_S = 2.0, 5e-4
"""Looks that tell little may differ by so many of their standard deviations more, each no more than the second (guess).
"""
MODELLED_TIMES = 1.3
"""What a first look leaves without the controller's model torque over what it leaves with it, up to which the delay
without it is asked for too: 1.02 at the most on real joints that moved alone, 1.9 to 21 on those of arms."""
TRAILING_S = (0.1, 0.3, 1.0)
"""Times with which a drag that trails the speed may follow it (guesses): it seems a delay where no column trails."""
LEAST_TURNS = 4
"""A motion that turns less often is one of constant speed, where ripple has any phase and torque no other."""
ALIKE = 1e-12
"""Power of a direction over the largest below which columns are the same but for rounding."""
ROUNDING = 1e-14
"""What is left of a torque's square over all of it below which nothing is: a log that a simulation wrote."""
LEAST_OWN = 0.1
"""Share of what a delay changes that nothing else makes: 0.04 along one sine, where it is damping and inertia, 0.2
along two, 0.4 to 1 in robots' logs."""


class _Look(NamedTuple):
    """What one look says of a delay."""

    late_s: float
    sd_s: float
    fall: float
    """share of the squared error that the delay takes"""
    power: float
    """mean square that is left with it"""


_NOTHING = _Look(0.0, math.inf, 0.0, math.inf)


def aligned(time_s: Array, columns: Mapping[str, Array], model: Model, block_s: float = BLOCK_S) -> PreparedMotion:
    """One recording ready, a drive's speed and torque at the instants of the angle. Raises `KinematicsError`."""
    trial = prepare(time_s, columns, model, block_s)
    if model.balance != "drive":
        return trial
    if SPEED in columns:
        trial = _with_speed(trial, time_s, columns, model)
    for name in MOTOR_TORQUES:
        if name in columns and (late_s := delay_of(trial)):
            trial = moved(trial, time_s, columns, model, {name: late_s})
    return trial


def moved(
    trial: PreparedMotion,
    time_s: Array,
    columns: Mapping[str, Array],
    model: Model,
    more_s: Mapping[str, float],
    all_of_it: bool = False,
) -> PreparedMotion:
    """The same recording, its channels moved by so much more; `all_of_it`: with what is `odd`."""
    late_s = dict(trial.late_s)
    for name, more in more_s.items():
        late_s[name] = late_s.get(name, 0.0) + more
    columns = {name: column for name, column in columns.items() if name not in trial.left_out}
    late_s = {name: late for name, late in late_s.items() if abs(late) > LEAST_KNOWN_S}
    told = (*trial.left_out.values(), *map(_told, late_s, late_s.values()))
    again = prepare(time_s, columns, model, trial.block_s, late_s, told, all_of_it)
    return replace(again, left_out=trial.left_out)


def _with_speed(trial: PreparedMotion, time_s: Array, columns: Mapping[str, Array], model: Model) -> PreparedMotion:
    """A recorded speed moved to the angle where its filter makes it late, or left out where that bends it besides: a
    first look at the drive then leaves more of the torque, over what noise would leave, with it than without."""
    late_s = speed_delay_of(trial)
    if not late_s:
        return trial
    moved_trial = moved(trial, time_s, columns, model, {SPEED: late_s})
    rest = {name: column for name, column in columns.items() if name != SPEED}
    alone = prepare(time_s, rest, model, trial.block_s)
    if _floors_left(moved_trial) <= BENT_TIMES * _floors_left(alone):
        return moved_trial
    told = f"{SPEED} is filtered, {1e3 * late_s:.1f} ms behind theta_out_rad, whose own rate tells more: left out"
    return replace(alone, remarks=(*alone.remarks, told), left_out={SPEED: told})


def _floors_left(trial: PreparedMotion) -> float:
    """rms of what a first look leaves of the torque, in noise floors."""
    x = trial.project(np.column_stack((drive_columns(trial.motion), trial.motion.torque_Nm)))
    q = _basis(x[:, :-1])
    left = x[:, -1] - q @ (q.T @ x[:, -1])
    return math.sqrt(float(np.mean(left**2))) / max(trial.drive_floor, 1e-300)


def _told(name: str, late_s: float) -> str:
    return f"{name} {'follows' if late_s > 0 else 'leads'} theta_out_rad by {1e3 * abs(late_s):.1f} ms: taken out"


def delay_of(trial: PreparedMotion) -> float:
    """Seconds by which the torque follows the angle, negative where it leads; 0 where that is not beyond doubt."""
    later = _later(trial, trial.motion.torque_Nm)
    first, *more = _looks([trial], [later], [trial.project(drive_columns(trial.motion))])
    unaided = _looks([trial], [later], [trial.project(drive_columns(replace(trial.motion, extra={})))])[:1]
    more += [look for look in unaided if look.power < MODELLED_TIMES**2 * first.power]
    if first.late_s:
        more += _looks([trial], [later], [_rippled(trial)])[:1]
        more += _looks([trial], [later], [_rough(trial)])[:1]
        slow = _slow(trial)
        later = _later(slow, trial.motion.torque_Nm)
        more += _looks([slow], [later], [slow.project(drive_columns(trial.motion))])[:1]
    return first.late_s if _sure(first, more) else 0.0


def _rough(trial: PreparedMotion) -> Array:
    """(m, k) columns of a first look, and of a drag that trails the speed."""
    motion = trial.motion
    keep = (np.full(len(motion), math.exp(-1 / (time_s * motion.rate_hz))) for time_s in TRAILING_S)
    speed = np.nan_to_num(motion.velocity_out_rad_s)
    trailing = [followed(speed, share, float(speed[0])) for share in keep]
    return trial.project(np.column_stack((drive_columns(motion), *trailing)))


def _rippled(trial: PreparedMotion) -> Array:
    """(m, k) columns of a first look, and of waves of any order that stand out of what they leave."""
    columns = trial.project(drive_columns(trial.motion))
    left = LeftOver.of(trial.target, columns)
    return np.hstack((columns, waves_beside(trial.motion, trial.rows, trial.fir.cutoff_hz, left, trial.project)))


def _slow(trial: PreparedMotion) -> PreparedMotion:
    """The same behind a filter that only lets slow motion pass, by as many rows as that needs."""
    fir = filters(trial.motion.rate_hz, min(SLOW_HZ, SLOW_SHARE * trial.motion.rate_hz))
    kept = trial.rows // trial.step % max(1, fir.step // trial.step) == 0
    rows = trial.rows[kept]
    unknown = unknown_directions(trial.unsure, rows, fir.value)
    return replace(trial, fir=fir, rows=rows, block=trial.block[kept], unknown=unknown)


def speed_delay_of(trial: PreparedMotion) -> float:
    """The same of the speed, which a filter makes late where it is recorded beside the angle."""
    rate = np.gradient(trial.motion.theta_out_rad) * trial.motion.rate_hz
    later = _later(trial, trial.motion.extra[SPEED], SPEED_DELAYS_S)
    first, *more = _looks([trial], [later], [trial.project(rate[:, None])], SPEED_DELAYS_S)
    return first.late_s if _sure(first, more) else 0.0


def known_delays_of(
    trials: Sequence[PreparedMotion],
    modelled: Sequence[Sequence[Array]],
    torque: str,
    together: bool,
    held_against: bool = False,
) -> dict[str, float]:
    """The same of the torque of some recordings beside the columns (m, k) in each of one model or another, that of the
    likeliest: shorter delays as well where little else is left, or the delay takes most of it. The model alone must say
    the same; and near the noise does by itself where all is `held_against` what else may be there. Or, where that may
    be, of the torque and the controller's model torque `together`, as one logger made them late: moved alone, either is
    out of step with the other."""
    rough, told = [trial.project(drive_columns(trial.motion)) for trial in trials], [(tuple[str, ...](), _NOTHING)]
    floor = math.sqrt(float(np.mean([trial.drive_floor**2 for trial in trials])))
    for names, channels in _may_be_late(trials, torque, together):
        later = list(map(_later, trials, channels))
        for columns in modelled:
            alone, *own_halves = _looks(trials, later, columns)
            first, *halves = _looks(trials, later, list(map(np.hstack, zip(rough, columns, strict=True))))
            near = alone.power <= (KNOWN_FLOORS * floor) ** 2
            least_fall = LEAST_FALL if near else MOST_FALL
            nothing_else = alone.power <= (NOTHING_ELSE_FLOORS * floor) ** 2
            by_itself = (nothing_else or (held_against and near)) and first.late_s * alone.late_s > 0.0
            beside = [] if held_against else own_halves
            if _believed(first, [alone, *halves], LEAST_KNOWN_S, APART_KNOWN_S, least_fall):
                told.append((names, first._replace(power=alone.power)))
            elif by_itself and _believed(alone, beside, LEAST_KNOWN_S, APART_KNOWN_S):
                told.append((names, alone))
    names, look = min(told, key=lambda row: row[1].power)
    return dict.fromkeys(names, look.late_s)


def _may_be_late(
    trials: Sequence[PreparedMotion], torque: str, together: bool
) -> Iterator[tuple[tuple[str, ...], list[Array]]]:
    """Channels that may be late by the same, and (n,) what of the torque they make in each recording: the torque alone,
    and that less as much of the model torque as it holds, if what else a joint is made of leaves that to be told."""
    yield (torque,), [trial.motion.torque_Nm for trial in trials]
    if together and all(MODELLED in trial.motion.extra for trial in trials):
        less = [_less_the_model(trial) for trial in trials]
        if not any(part is None for part in less):
            yield (torque, MODELLED), [part for part in less if part is not None]


def _less_the_model(trial: PreparedMotion) -> Array | None:
    motion = trial.motion
    model = motion.extra[MODELLED]
    passed, q = trial.project(model[:, None])[:, 0], _basis(trial.project(drive_columns(replace(motion, extra={}))))
    own, left = (part - q @ (q.T @ part) for part in (passed, trial.target))
    if np.linalg.norm(own) <= LEAST_OWN * np.linalg.norm(passed):
        return None
    return np.asarray(motion.torque_Nm - float(own @ left) / float(own @ own) * model)


def retimed(
    trials: Sequence[PreparedMotion],
    recordings: Sequence[Recorded],
    model: Model,
    columns: Sequence[Array],
    together: bool,
    held_against: bool = False,
) -> list[PreparedMotion] | None:
    """The trials, the torque of each moved by what it is late beside the columns (m, k), over all rows, of one model or
    another, and the model torque with it where these hold that and are `together` so; None where none is late. Where no
    recording tells a delay alone, as short ones do not, all are asked for the one that their logger has."""
    modelled = [np.split(whole, np.cumsum([len(trial.rows) for trial in trials])[:-1]) for whole in columns]
    torques = [next(name for name in MOTOR_TORQUES if name in row.columns) for row in recordings]
    late_s = [
        known_delays_of([trial], [[parts[i]] for parts in modelled], torques[i], together, held_against)
        for i, trial in enumerate(trials)
    ]
    if len(trials) > 1 and not any(late_s) and len(set(torques)) == 1:
        late_s = [known_delays_of(trials, modelled, torques[0], together, held_against)] * len(trials)
    if len(set(torques)) == 1:
        _follow(trials, modelled, torques[0], late_s)
    if not any(late_s):
        return None
    return [
        moved(trial, recording.time_s, recording.columns, model, more) if more else trial
        for trial, recording, more in zip(trials, recordings, late_s, strict=True)
    ]


def _follow(
    trials: Sequence[PreparedMotion], modelled: Sequence[Sequence[Array]], torque: str, late_s: list[dict[str, float]]
) -> None:
    """Recordings that tell no delay of their own are given that of the others, the middle one, where they are made of
    columns (m, k), of one model or another, better with it: they have one logger."""
    whole = [trial.late_s.get(torque, 0.0) + more.get(torque, 0.0) for trial, more in zip(trials, late_s, strict=True)]
    told = sorted(late for late in whole if late)
    together = any(MODELLED in (*trial.late_s, *more) for trial, more in zip(trials, late_s, strict=True))
    for i, trial in enumerate(trials if told and not together else ()):
        middle = told[len(told) // 2]
        if not whole[i] and _better_by(trial, [parts[i] for parts in modelled], middle):
            late_s[i] = {torque: middle}


def _better_by(trial: PreparedMotion, columns: Sequence[Array], seconds: float) -> bool:
    """Whether columns (m, k) of one model or another make more of the torque as it was so much later."""
    inside = _inside(trial, abs(seconds))
    later = _later(trial, trial.motion.torque_Nm, np.array([0.0, seconds]))[inside]
    bases = [_basis(x[inside]) for x in columns]
    left = [np.sum((later - q @ (q.T @ later)) ** 2, axis=0) for q in bases]
    as_read, moved_so = min(left, key=min)
    return bool(moved_so < as_read)


def _sure(first: _Look, more: Sequence[_Look]) -> bool:
    """Whether a delay is long, or takes most of the error, and beyond doubt."""
    return _believed(first, more, LEAST_S, APART_S) or _believed(first, more, LEAST_KNOWN_S, APART_KNOWN_S, MOST_FALL)


def _believed(
    first: _Look, more: Sequence[_Look], least_s: float, apart_s: float, least_fall: float = LEAST_FALL
) -> bool:
    """Whether a delay is beyond doubt: long, sure, worth it, and the same by other looks."""
    others = (abs(first.late_s - other.late_s) - APART_SD * min(other.sd_s, UNTOLD_S) for other in more)
    apart = max(others, default=0.0)
    return abs(first.late_s) > max(least_s, SURE_SD * first.sd_s) and first.fall > least_fall and apart < apart_s


def _later(trial: PreparedMotion, late: Array, delays_s: Array = DELAYS_S) -> Array:
    """(m, d) rows of a channel (n,) as it was later by each delay."""
    return trial.project(_shifted(late, trial.motion.rate_hz, delays_s))


def _looks(
    trials: Sequence[PreparedMotion], later: Sequence[Array], made_of: Sequence[Array], delays_s: Array = DELAYS_S
) -> list[_Look]:
    """At a channel of recordings at each delay (m, d) that is made of columns (m, k): all of it and its halves."""
    if sum(map(_turns, trials)) < LEAST_TURNS:
        return [_NOTHING] * 3
    inside = [_inside(trial, float(delays_s[-1])) for trial in trials]
    blocks = [trial.block for trial in trials]
    x, y, block = (np.concatenate([part[at] for part, at in zip(parts, inside, strict=True)])
                   for parts in (made_of, later, blocks))  # fmt: skip
    every = np.arange(len(x))
    return [_likeliest(x[part], y[part], block[part], delays_s) for part in (every, *np.array_split(every, 2))]


def _turns(trial: PreparedMotion) -> int:
    speed = trial.motion.velocity_out_rad_s[trial.rows]
    moving = np.abs(speed) > 0.1 * np.abs(speed).max(initial=0.0)
    return int(np.count_nonzero(np.diff(np.sign(speed[moving]))))


def _inside(trial: PreparedMotion, longest_s: float) -> Mask:
    """(m,) rows that a channel so late still reaches."""
    reach = math.ceil(longest_s * trial.motion.rate_hz)
    return np.asarray((trial.rows >= reach) & (trial.rows < len(trial.motion) - reach))


def _shifted(late: Array, rate_hz: float, delays_s: Array) -> Array:
    """(n, d) a channel as it was later by each of the delays, band-limited."""
    y = np.where(np.isfinite(late), late, 0.0)
    line, slope = np.linspace(y[0], y[-1], len(y)), (y[-1] - y[0]) / (len(y) - 1) * rate_hz
    length = fft.next_fast_len(len(y) + math.ceil(float(np.abs(delays_s).max()) * rate_hz), real=True)
    spectrum, turn = fft.rfft(y - line, length), 2j * math.pi * fft.rfftfreq(length, 1 / rate_hz)
    delays = (fft.irfft(spectrum * np.exp(turn * d), length)[: len(y)] + line + slope * d for d in delays_s)
    return np.stack(list(delays), axis=1)


def _basis(x: Array) -> Array:
    """(m, r) orthonormal, of the columns (m, k); none where there are too few rows."""
    size = np.sqrt(np.mean(x**2, axis=0)) if len(x) > 2 * x.shape[1] else np.zeros(x.shape[1])
    even = x[:, size > 0] / size[size > 0]
    power, across = np.linalg.eigh(even.T @ even)
    seen = power > ALIKE * power.max(initial=0.0)
    return np.asarray(even @ (across[:, seen] / np.sqrt(power[seen])))


def _likeliest(x: Array, y: Array, block: NDArray[np.intp], delays_s: Array) -> _Look:
    """The delay of least squared error of y (m, d) beside x (m, k): a parabola of the delay near there. Of infinite sd
    where it is at an end, or what it changes is made by others as well."""
    q = _basis(x)
    taken = q.T @ y
    whole, made = (np.einsum("ij,ij->j", part, part) for part in (y, taken))
    power = np.maximum(whole - made, ROUNDING * whole) + 1e-300
    best, zero, step_s = int(np.argmin(power)), len(power) // 2, float(delays_s[1] - delays_s[0])
    bend = np.diff(power[best - 1 : best + 2])
    if len(bend) < 2 or not bend[1] > bend[0]:
        return _NOTHING
    left = y[:, best - 1 : best + 2] - q @ taken[:, best - 1 : best + 2]
    own, change = (np.linalg.norm(part[:, 2] - part[:, 0]) for part in (left, y[:, best - 1 : best + 2]))
    if own < LEAST_OWN * change:
        return _NOTHING
    off, curve = -0.5 * (bend[1] + bend[0]) / (bend[1] - bend[0]), bend[1] - bend[0]
    least = max(float(power[best] - 0.5 * off**2 * curve), 1e-3 * float(power[best]))
    count = independent(left[:, 1], block, max(2, len(x) // 20))
    sd_s = step_s * math.sqrt(2 * least / (count * curve))
    return _Look(float(delays_s[best] + off * step_s), sd_s, 1 - least / power[zero], least / len(y))

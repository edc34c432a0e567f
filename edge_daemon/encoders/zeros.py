"""Where the encoders count from: lasting shifts of their zeros, told and put right.

The twist less all that the gear and its motion make of it (`slope`) stays on one level. A level that moves away and
stays is a zero that moved: a coupling slipped, a counter came back from a power dip counting from elsewhere, or the
gear has ratcheted. Which encoder it was, its own samples say where they jump at once (`edges`) or were missing, and
the kinematic error, whose waves turn with the motor's zero alone. The angle is then carried on from where it was, so
that nothing that was learned changes; while it is not yet sure, nothing is learned.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from edge_daemon.encoders.edges import SAMPLES, Edge, EdgeFinder
from edge_daemon.encoders.ratio import COLUMNS, COMPLIANCE, LAG, SKEW, SLOPE, WAVES, Slope
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array, Block, Estimate, Flags, Flaw, Mask, Status

MOTOR, OUT = "theta_in_rad", "theta_out_rad"
NAMES = {
    MOTOR: f"{MOTOR} (motor encoder)",
    OUT: f"{OUT} (output encoder)",
    "": f"{MOTOR} or {OUT} (nobody can tell which)",
}
SLIPS_RAD = {MOTOR: 0.1, OUT: 0.01}
"""A coupling slips up to this angle of its own shaft; a counter comes back anywhere (guess)."""
SHARP, SEEN = 2.5, 1.3
"""Times the sharpest edge before: one that raises a doubt, and one that is believed where a shift of its size stays."""
ALIKE, BLURRED = 0.25, 0.5
"""An edge and the shift that stays may differ by this share of it, for the gear swings where it is let go, and by this
share of the sharpest edge before."""
HIDDEN_RAD = {MOTOR: 0.05, OUT: 5e-3}
"""Edges beyond this are kept from the filters at once: a torque that they make would be beyond any gear's."""
AWAY, ANNOUNCED = 6.0, 3.0
"""Beyond the first number of sd of the level it has moved, and beyond the second what announces it is worth waiting
for."""
FAR = 1.5
"""Beyond this many times all that the twist has shown a level without an edge has moved: less may be a load."""
BACK, HALF_WAY = 0.3, 0.5
"""A level stands where it stood within the first share of what an edge announced, and within the second of what counts
as far (guess)."""
WHOLE = 1e-3
"""A counter that loses turns loses whole ones to this share of a motor turn; a coupling that slips hits one in so many
(guess)."""
LASTING_S = 0.8
"""A level is a new one after this long: a frozen encoder is found out before."""
GIVES_UP_S = 4.0
"""A level that has not settled for so long tells nothing."""
LEVELS, FEWEST, FEW = 100, 8, 4.0
"""The scatter is known from at most and at least so many levels, and may be larger by this share of one over their
number."""
WORSE = 2.0
"""Of a level this many times as doubtful what a regression says now is not taken over."""
KEPT = 40
"""A doubt holds at most so many stretches."""
CENTRE = 15.0
"""So many levels are averaged to where it stands."""
LEAST_ROWS = 10
MOVING_RAD = 1e-3
"""A stretch with this travel of the output shows what is usual."""
REACH_MEMORY_S = 60.0
"""How far the twist went is remembered over so much motion."""
SHORT_RAD = 0.002
"""A load may have moved the twist this far from whole tooth pitches beside a slip by teeth."""
MOST_PITCHES = 10
"""More pitches at once are an encoder's."""
TOLD_APART = 2.0
"""A hypothesis that leaves this many times the squares of another is refuted."""
TURNS = 3
"""A first guess of the motor's shift is off by the kinematic error times the ratio, the next by a hundredth of it."""
LOOKS_S, MOST_LOOKS = 2.0, 300
"""What the samples showed is remembered from this long before the newest level, in at most so many blocks."""
TURNED = 1.0
"""With this travel of the motor's sine the kinematic error tells whose zero has moved."""


class _Look(NamedTuple):
    """What the samples of a block show by themselves."""

    end_s: float
    edges: Mapping[str, tuple[float, Edge]]
    """channel -> when, and the sharpest"""
    flawed: Mapping[str, float]
    """channel -> since when samples of it are missing or refused"""
    reset: bool
    """the conditioning saw a counter jump that no gear can make, has told it and carries the angle on, nearly"""


@dataclass(slots=True)
class _Doubt:
    """A level that seems to have moved."""

    looks: list[_Look]
    expected_rad: float
    """shift that an edge announced; NaN without one"""
    waited_s: float = 0.0
    levels: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    stretches: deque[Stretch] = field(default_factory=lambda: deque(maxlen=KEPT))
    counted: int = 1

    @property
    def newest(self) -> list[Stretch]:
        """Those that decide."""
        return list(self.stretches)[-self.counted :]


class ZeroWatch:
    """Of one drive with two encoders."""

    def __init__(self, ratio: float) -> None:
        """`ratio` of a strain wave gear, that gives the teeth of the circular spline."""
        self.ratio = ratio
        self.pitch_rad = 2 * math.pi / (2 * (abs(ratio) + 1))
        self.ratcheting_events = 0
        self.encoder_resets = 0
        """that the conditioning saw"""
        self.shifts = 0
        """of a zero, that were found here"""
        self.moved = False
        """whether the newest stretch decided that what follows is counted from elsewhere"""
        self.time_s = math.nan
        self._origin_rad = dict.fromkeys((MOTOR, OUT), 0.0)
        self._finders = {MOTOR: EdgeFinder(), OUT: EdgeFinder()}
        self._looks: deque[_Look] = deque()
        self._end_s = self._judged_s = math.nan
        self._lost = True
        self._notices: list[str] = []
        self._value, self._covariance = np.zeros(COLUMNS), np.zeros((COLUMNS, COLUMNS))
        self._known = False
        self._solved: Array | None = None
        self._from_rad = 0.0
        self._variance_rad2, self._levels = 0.0, 0
        """of the levels of a moving drive, and how many there were"""
        self._centre_rad, self._averaged = math.nan, 0
        self._reach_rad = 0.0
        """how far the twist went, as far as nothing that came after it has raised a doubt"""
        self._newest_reach_rad = 0.0
        self._doubt: _Doubt | None = None

    # samples

    def carried(self, block: Block) -> Block:
        """The block with both angles carried on from where they were."""
        if not (MOTOR in block.values and OUT in block.values):
            return block
        good = {name: _good(block, name) for name in self._finders}
        self._lost = any(mask is not None and not mask.any() for mask in good.values())
        if not self._lost:
            self.time_s = block.end_s
        flawless = all(mask is None for mask in good.values())
        reset = not flawless and _was_reset(block)
        self.encoder_resets += reset
        if any(self._origin_rad.values()):
            angles = {name: block.values[name] - self._origin_rad[name] for name in self._finders}
            block = replace(block, values={**block.values, **angles})
        follows = block.starts_at(self._end_s)
        self._end_s = block.end_s
        moves = _moves(block.values[OUT])
        edges, hidden = {}, {}
        for name, finder in self._finders.items():
            if not follows:
                finder.forget()
            edge = finder.look(block.values[name], good[name], block.rate_hz, moves)
            edges[name] = block.start_s + edge.place / block.rate_hz, edge
            if edge.share > SHARP and abs(edge.size_rad) > HIDDEN_RAD[name]:
                hidden[name] = _marked(block.flaws[name], edge.place)
        flawed = dict.fromkeys(good, block.start_s) if not follows else {}
        flawed |= {
            name: block.start_s + float(mask.argmin()) / block.rate_hz
            for name, mask in good.items()
            if mask is not None and _is_interrupted(block, name)
        }
        self._looks.append(_Look(block.end_s, edges, flawed, reset))
        while self._looks[0].end_s < self._judged_s - LOOKS_S or len(self._looks) > MOST_LOOKS:
            self._looks.popleft()
        return replace(block, flaws={**block.flaws, **hidden}) if hidden else block

    # levels

    def judge(self, stretch: Stretch, slope: Slope) -> Stretch:
        """The stretch, not to be learned from while a zero may have moved. `slope` knows the gear and its motion."""
        self.moved = False
        doubt = self._doubt
        duration_s = len(stretch.motion) / stretch.motion.rate_hz
        if np.count_nonzero(stretch.valid) < LEAST_ROWS or not self._looks:
            if doubt is not None:
                self._wait(doubt, duration_s)
            return stretch
        self._judged_s = self._end_s
        if doubt is None:
            self._adopt(stretch, slope)
        level = self._level(stretch, self._value)
        if doubt is None:
            self._doubt = doubt = self._raise(stretch, level)
            if doubt is None:
                self._follow(stretch, level)
                return stretch
        elif self._is_back(doubt, level):
            self._doubt = None
            return stretch
        self._newest_reach_rad = 0.0
        doubt.levels.append(level)
        doubt.stretches.append(stretch)
        self._settle(doubt, duration_s)
        if self._doubt is None and not self.moved:
            return stretch
        return replace(stretch, valid=np.zeros(len(stretch.valid), dtype=bool))

    def _rest(self, stretch: Stretch, value: Array) -> Array:
        """(n,) twist less what the gear and its motion make of it; waves and level are still in it."""
        motion = stretch.motion
        rest: Array = motion.twist_rad + stretch.zero_rad - value[SLOPE] * (motion.theta_out_rad - self._from_rad)
        if self._known:
            rest = rest - value[COMPLIANCE] * motion.torque_Nm - value[LAG] * motion.twist_rate_rad_s
            rest -= value[SKEW] * (motion.velocity_out_rad_s + motion.twist_rate_rad_s)
        return rest

    def _level(self, stretch: Stretch, value: Array) -> float:
        """Where the twist stands; a median, for a part of the stretch may have been before a shift."""
        rest = self._rest(stretch, value) - stretch.kinematic @ value[WAVES]
        return _middle(rest[stretch.valid])

    def _adopt(self, stretch: Stretch, slope: Slope) -> None:
        """Take over what the regression knows, where it is no worse known than before."""
        if slope.value is self._solved or not math.isfinite(float(slope.value[SLOPE])):
            return
        self._solved, row = slope.value, self._row(stretch)
        value, covariance = slope.value[:COLUMNS], slope.covariance[:COLUMNS, :COLUMNS]
        if self._known and _sd(row, covariance) > WORSE * _sd(row, self._covariance):
            return
        if not self._known:
            self._known = True
            self._forget_level()
            self._levels = 0
        self._centre_rad -= float(row @ (value - self._value))
        self._value, self._covariance = value, covariance

    def _row(self, stretch: Stretch) -> Array:
        """(COLUMNS,) means of the regression's columns, but of the level's: what a wrong value of them moves it by."""
        motion, row = stretch.motion, np.zeros(COLUMNS)
        row[SLOPE] = motion.theta_out_rad.sum() / len(motion) - self._from_rad
        row[COMPLIANCE] = motion.torque_Nm.sum() / len(motion)
        row[SKEW] = motion.velocity_out_rad_s.sum() / len(motion)
        row[WAVES] = stretch.kinematic.sum(axis=0) / len(motion)
        return row

    def _follow(self, stretch: Stretch, level: float) -> None:
        """A level as usual."""
        out = stretch.motion.theta_out_rad
        off = level - self._centre_rad if math.isfinite(self._centre_rad) else 0.0
        self._centre_rad = level if not self._averaged else self._centre_rad + off / min(self._averaged + 1, CENTRE)
        self._averaged += 1
        moving = _moves(out)
        twist = stretch.motion.twist_rad + stretch.zero_rad - self._centre_rad
        twist = twist[stretch.valid] - self._value[SLOPE] * (out[stretch.valid] - self._from_rad)
        keep = math.exp(-len(out) / stretch.motion.rate_hz / REACH_MEMORY_S) if moving else 1.0
        self._reach_rad = max(keep * self._reach_rad, self._newest_reach_rad)
        self._newest_reach_rad = float(np.abs(twist).max())
        if moving and self._averaged > 1:
            self._levels += 1
            self._variance_rad2 += (off * off - self._variance_rad2) / min(self._levels, LEVELS)
        step = float(out[-1]) - self._from_rad
        self._from_rad += step
        self._centre_rad += self._value[SLOPE] * step

    def _sd_rad(self, stretch: Stretch) -> float:
        """Of its level, for what is not known of gear and motion."""
        return _sd(self._row(stretch), self._covariance) if self._known else 0.0

    def _forget_level(self) -> None:
        self._centre_rad, self._averaged, self._doubt = math.nan, 0, None

    def _spread_rad(self) -> float:
        """sd of a level about where it stands."""
        return math.sqrt(self._variance_rad2) * (1 + FEW / min(self._levels, LEVELS))

    def lose(self, turned_rad: float) -> None:
        """The readings were wrong for a while: where the twist stands is to be found anew, and is no shift. The motor
        counts by `turned_rad` more than before."""
        self._origin_rad[MOTOR] += turned_rad
        self._forget_level()
        for finder in self._finders.values():
            finder.forget()

    # doubts

    def _raise(self, stretch: Stretch, level: float) -> _Doubt | None:
        """A doubt that these samples or this level raise."""
        if self._levels < FEWEST or not self._averaged:
            return None
        off, spread_rad, newest = abs(level - self._centre_rad), self._spread_rad(), self._looks[-1]
        sharp = [(edge.share, name) for name, (_, edge) in newest.edges.items() if edge.share > SHARP]
        carried_on = any(look.reset for look in self._looks)
        if off < AWAY * spread_rad and not sharp and not carried_on:
            return None  # nearly always
        expected_rad = self._twisted(*max(sharp)[1:], newest) if sharp else math.nan
        least = AWAY * math.hypot(spread_rad, self._sd_rad(stretch))
        far = self._known and off > FAR * self._reach_rad
        away = any(look.flawed for look in self._looks) and self._known and off > self._reach_rad
        moved = off > least and (far or away or bool(self._shown(level)))
        announced = max(abs(expected_rad) if sharp else 0.0, off if carried_on else 0.0) > least * ANNOUNCED / AWAY
        return _Doubt(list(self._looks), expected_rad) if moved or announced else None

    def _shown(self, level: float, looks: Iterable[_Look] | None = None) -> dict[str, tuple[float, float]]:
        """Channels that themselves show this level's shift: how sharply, and when."""
        by_rad = level - self._centre_rad
        shown: dict[str, tuple[float, float]] = {}
        for look in looks or self._looks:
            for name, (at_s, edge) in look.edges.items():
                close = abs(self._twisted(name, look) - by_rad)
                usual_rad = edge.usual_rad / (abs(self.ratio) if name == MOTOR else 1.0)
                if edge.share > SEEN and close < ALIKE * abs(by_rad) + BLURRED * usual_rad:
                    shown[name] = max(shown.get(name, (0.0, 0.0)), (edge.share, at_s))
        return shown

    def _twisted(self, name: str, look: _Look) -> float:
        """Shift of the twist [rad] that the edge of a channel makes."""
        size_rad = look.edges[name][1].size_rad
        return size_rad / self.ratio if name == MOTOR else -size_rad

    def _is_back(self, doubt: _Doubt, level: float) -> bool:
        """Whether a later stretch stands where it stood before, and not where an edge announced."""
        off = abs(level - self._centre_rad)
        if not doubt.levels:
            return False
        if math.isfinite(doubt.expected_rad):
            return off < BACK * abs(doubt.expected_rad)
        return off < HALF_WAY * FAR * self._reach_rad

    def _wait(self, doubt: _Doubt, duration_s: float) -> None:
        doubt.waited_s += duration_s
        if doubt.waited_s > GIVES_UP_S:
            self._forget_level()

    def _settle(self, doubt: _Doubt, duration_s: float) -> None:
        """Decide where the level has stayed for long enough; the stretch that raised the doubt does not count."""
        if len(doubt.looks) < MOST_LOOKS:
            doubt.looks.append(self._looks[-1])
        self._wait(doubt, duration_s)
        count = math.ceil(LASTING_S / duration_s - 1e-6)
        doubt.counted = count
        if self._doubt is None or len(doubt.levels) <= count:
            return
        newest = np.array(doubt.levels)[-count:]
        by_rad = float(newest.mean()) - self._centre_rad
        spread_rad = self._spread_rad()
        if np.ptp(newest) > ALIKE * abs(by_rad) + AWAY * spread_rad:
            return
        name, since_s, flawed = self._attributed(doubt, by_rad)
        if not name and flawed and not self._has_turned(doubt):
            doubt.waited_s -= duration_s  # only motion tells
            return
        self._doubt = None
        sd_rad = math.hypot(spread_rad / math.sqrt(count), self._sd_rad(doubt.stretches[-1]))
        reset = any(look.reset for look in doubt.looks)
        if not name and not flawed and not reset and abs(by_rad) < FAR * self._reach_rad:
            self._forget_level()  # nothing that an encoder shows, and no more than a load may do
            return
        self._tell(doubt, name, by_rad, sd_rad, since_s, flawed, reset)

    @staticmethod
    def _has_turned(doubt: _Doubt) -> bool:
        """Whether the motor has, in all of the newest stretches."""
        return all(np.ptp(stretch.kinematic[:, 0]) > TURNED for stretch in doubt.newest)

    def _attributed(self, doubt: _Doubt, by_rad: float) -> tuple[str, float, bool]:
        """Which channel itself shows this shift ("" for neither or both), since when, and whether samples of it were
        missing."""
        shown = self._shown(self._centre_rad + by_rad, doubt.looks)
        if shown:
            name = max(shown, key=lambda row: shown[row])
            return name, shown[name][1], False
        flawed: dict[str, float] = {}
        for look in doubt.looks:
            for name, at_s in look.flawed.items():
                flawed.setdefault(name, at_s)
        if len(flawed) == 1:
            name, at_s = next(iter(flawed.items()))
            return name, at_s, True
        onset = doubt.looks[-1].end_s - doubt.waited_s
        return "", min(flawed.values(), default=onset), bool(flawed)

    def _tell(
        self, doubt: _Doubt, name: str, by_rad: float, sd_rad: float, since_s: float, flawed: bool, reset: bool
    ) -> None:
        """Put it right and say it."""
        turn_rad = 2 * math.pi / abs(self.ratio)
        pitches, turns = round(by_rad / self.pitch_rad), round(by_rad / turn_rad)
        from_pitches, from_turns = abs(by_rad - pitches * self.pitch_rad), abs(by_rad - turns * turn_rad)
        whole = turns != 0 and name != OUT and from_turns < AWAY * sd_rad + WHOLE * turn_rad
        slipped = (
            not reset
            and name != MOTOR
            and 0 < abs(pitches) <= MOST_PITCHES
            and from_pitches < AWAY * sd_rad + SHORT_RAD
        )
        if slipped and not (whole and from_turns < from_pitches):
            self.ratcheting_events += abs(pitches)
            what = f"the gear has ratcheted by {abs(pitches)} tooth pitch{'es' * (abs(pitches) > 1)}"
            name = OUT
        else:
            name = name or (MOTOR if whole else self._by_waves(doubt, by_rad))
            if whole:
                by_rad = turns * turn_rad
            elif name == MOTOR:
                by_rad = self._turned_level(doubt, by_rad)
            what = self._named(name, by_rad, turns if whole else 0, flawed)
        before_s = doubt.stretches[-1].motion.time_s[-1] - since_s
        if not reset:
            self._notices.append(
                f"{what}, {max(before_s, 0.0):.1f} s ago: carried on from there; what was learned stays"
            )
        self._origin_rad[name or OUT] += by_rad * self.ratio if name == MOTOR else -by_rad
        self.moved = True
        self.shifts += 1
        for finder in self._finders.values():
            finder.forget()

    def _named(self, name: str, by_rad: float, turns: int, flawed: bool) -> str:
        """What an encoder did."""
        own_rad = by_rad * self.ratio if name == MOTOR else -by_rad
        size = f"{own_rad:+.3g} rad"
        if not name:
            load = (
                f", or a lasting load of {abs(by_rad) / self._value[COMPLIANCE]:.3g} N m came on"
                if (self._known and self._value[COMPLIANCE] > 0 and not flawed)
                else ""
            )
            return f"{NAMES[name]} counts from elsewhere, the twist by {by_rad:+.3g} rad (slip or encoder reset){load}"
        if turns:
            whole = f"{abs(turns)} whole turn{'s' * (abs(turns) > 1)}"
            return f"{NAMES[name]} was reset: it counts from elsewhere by {whole} ({size})"
        if abs(own_rad) < SLIPS_RAD[name]:
            return f"{NAMES[name]}: its zero slipped by {size} ({10_800 / math.pi * abs(own_rad):.3g} arc-min)"
        return f"{NAMES[name]} was reset: it counts from elsewhere by {size}"

    def _by_waves(self, doubt: _Doubt, by_rad: float) -> str:
        """The encoder whose shift leaves the kinematic error in phase; "" where that does not tell."""
        if not self._known:
            return ""
        rest = [self._rest(stretch, self._value)[stretch.valid] for stretch in doubt.newest]
        waves = [stretch.kinematic[stretch.valid] for stretch in doubt.newest]
        joined, columns, kept = np.concatenate(rest), np.concatenate(waves), self._value[WAVES]
        left = {OUT: kept, MOTOR: turned(kept, by_rad * self.ratio)}
        squares = {name: float(np.var(joined - columns @ row)) for name, row in left.items()}
        best, worst = sorted(squares, key=lambda name: squares[name])
        return best if squares[worst] > TOLD_APART * squares[best] else ""

    def _turned_level(self, doubt: _Doubt, by_rad: float) -> float:
        """The shift [rad] of the twist once the kinematic error is turned with the motor's zero."""
        for _ in range(TURNS):
            waves = turned(self._value[WAVES], by_rad * self.ratio)
            levels = [
                _middle((self._rest(stretch, self._value) - stretch.kinematic @ waves)[stretch.valid])
                for stretch in doubt.newest
            ]
            by_rad = sum(levels) / len(levels) - self._centre_rad
        return by_rad

    # what is said

    def take_notices(self) -> tuple[str, ...]:
        """What happened since the last call."""
        taken, self._notices = tuple(self._notices), []
        return taken

    def estimate(self) -> Estimate:
        """Tooth pitches by which the gear has ratcheted so far."""
        counted = Status.VALID if self._averaged or self._doubt is not None else Status.WARMING_UP
        status = Status.INVALID if self._lost else counted
        return Estimate("ratcheting_events", float(self.ratcheting_events), 0.0, "1", status, self.time_s)

    def dump(self) -> dict[str, Any]:
        """What must outlive a restart."""
        origins = [float(self._origin_rad[name]) for name in (MOTOR, OUT)]
        return {"ratcheting_events": self.ratcheting_events, "origins": origins}

    def load(self, state: dict[str, Any]) -> None:
        """Take back what `dump` gave. Raises KeyError, TypeError or ValueError when it does not fit."""
        events, origins = int(state["ratcheting_events"]), [float(v) for v in state["origins"]]
        if not (len(origins) == 2 and all(map(math.isfinite, origins))):
            raise ValueError("origins")
        self._origin_rad.update(zip((MOTOR, OUT), origins, strict=True))
        self.ratcheting_events = events


def turned(waves: Array, by_rad: float) -> Array:
    """Sine and cosine of each order of a motor angle, as they stand over one that counts by so much more."""
    out = np.empty(2 * len(ORDERS))
    for i, order in enumerate(ORDERS):
        sine, cosine = waves[2 * i], waves[2 * i + 1]
        s, c = math.sin(order * by_rad), math.cos(order * by_rad)
        out[2 * i], out[2 * i + 1] = sine * c + cosine * s, cosine * c - sine * s
    return out


def _moves(out: Array) -> bool:
    """Whether the output does; the cost of numpy's peak to peak is three times that."""
    return bool(out.max() - out.min() > MOVING_RAD)


def _sd(row: Array, covariance: Array) -> float:
    """Of row @ unknowns."""
    return math.sqrt(max(float(row @ covariance @ row), 0.0))


def _is_interrupted(block: Block, name: str) -> bool:
    """Whether samples are missing or refused; one that does not change is not away, the drive may just rest."""
    flaws = block.flaws[name]
    return bool((flaws & ~np.uint8(Flaw.FROZEN)).any() or not np.isfinite(block.values[name]).all())


def _was_reset(block: Block) -> bool:
    """Whether the conditioning says so."""
    return any(bool((block.flaws[name] & np.uint8(Flaw.RESET)).any()) for name in (MOTOR, OUT))


def _good(block: Block, name: str) -> Mask | None:
    """(n,) samples without flaws; None for all of them."""
    finite, flaws = np.isfinite(block.values[name]), block.flaws.get(name)
    if flaws is not None and not np.count_nonzero(flaws) and np.count_nonzero(finite) == len(finite):
        return None
    return finite & block.valid(name)


def _marked(flaws: Flags, place: int) -> Flags:
    """With the samples about an edge marked."""
    flaws = flaws.copy()
    flaws[max(place - SAMPLES // 2, 0) : max(place + SAMPLES // 2, 0)] |= np.uint8(Flaw.RATE)
    return flaws


def _middle(values: Array) -> float:
    """The upper median; a tenth of the cost of numpy's."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])

"""Whether the readings contradict the gear, and which reading would explain it: a likelihood between hypotheses.

Whatever a gear does to its twist follows its torque, its twist rate, their signs and the motor angle, within plausible
bounds. A block whose twist none of these explains, far beyond what is usual, is no change of the gear. What would
explain it is tried next: a shift in time between the encoders moves the twist with the speed, a wrong scale moves it
with the angle, and an encoder that stands still, counts backward or has changed places shows in the two speeds alone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from edge_daemon.encoders.ratio import COLUMNS, COMPLIANCE, LAG, LEVEL, SKEW, SLOPE, WAVES, Slope
from edge_daemon.encoders.zeros import turned
from edge_daemon.motion.streaming import ORDERS, Stretch
from edge_daemon.records import Array

Some = tuple[int, ...]
"""Places of unknowns."""
MOTOR, OUT = "theta_in_rad", "theta_out_rad"
BOTH = (MOTOR, OUT)
GAP, DRY = COLUMNS, COLUMNS + 1
"""Columns beyond those of the ratio's regression: the signs of the torque and of the twist rate."""
RATES = slice(DRY + 1, DRY + 1 + 2 * len(ORDERS))
"""Columns of the rates of the kinematic error's waves, which damping turns into twist."""
UNKNOWNS = RATES.stop
GEARS = (COMPLIANCE, LAG, GAP, DRY, *range(RATES.start, RATES.stop))
"""Unknowns that a change of the gear moves."""
PHASES = tuple(range(WAVES.start, WAVES.stop))
FAR = 3.0
"""Times the usual residual, beyond which a block contradicts what is known (guess)."""
SHARE = 0.1
"""Residual over the twist that the torque makes, below which nothing is called a contradiction (guess)."""
USUAL_MEMORY_S = 30.0
"""Time over which the usual residual is averaged."""
SURE_S = 10.0
"""Time of motion that must have been usual before anything can contradict it (guess)."""
NAMES_AFTER_S = 0.85
"""Time of contradiction, after the block in which it began, before its cause is named: three blocks."""
NEWEST_BLOCKS = 7
"""Blocks of contradiction from which its cause is named: two seconds, as the daemon gathers them."""
GOOD_S = 0.8
"""Time without contradiction after which it is over."""
EXPLAINED = 0.5
"""Share of the residual's power that a cause may leave: as a likelihood, odds beyond e to the thirty in a second."""
FEWEST_ROWS = 30
"""Usable samples of a block, below which it says nothing."""
LOADED = 0.5
"""Torque over its rms in the block, below which a sample is left out: a gear rattles and sticks there (guess)."""
GEARS_SHARE = 0.15
"""Share of what does not fit, that the best gear may leave where no encoder explains it better: it is the gear then,
and the rest is what these few laws lack (guess; a backlash that opens leaves 0.02, a bit that sticks 0.3)."""
OWN_SHARE = 1.0
"""Prior sd of a gear's compliance and dry friction over what is known of them: a factor of two is no wonder (guess)."""
LAG_SD_S = 3e-3
"""Prior sd of damping over stiffness: beyond any gear's, and far below what imitates a shift in time (guess)."""
LEAST_LAG_S, LEAST_WAVE_RAD = 1e-4, 1e-5
"""Damping over stiffness and kinematic error that a gear may have at least, whatever is known of it (guess)."""
GAP_SD_RAD = 3e-4
"""Prior sd of half a backlash: one arc minute, and more than a gear has before it is scrapped (guess)."""
TURNS = 144
"""Motor zeros that are tried before the best is refined: a fourth order turns by ten degrees in each step."""
LEAPS = 0.25
"""An order of the kinematic error leaps by this share of the largest at least (guess: the disc of a motor's encoder
that moves by a hundredth of a radian makes one as large as the gear's own)."""
LEAP_BLOCKS, LEAP_RAD = 4, 4 * math.pi
"""So many of the newest blocks tell it, and two turns of the motor: a second of motion (guess)."""
TOLD_APART = 2.0
"""Times the squares that the best zero leaves, and that of before is refuted."""
UNEXPLAINED = "unexplained"
GIVES_IN_S = 30.0
"""Time of a contradiction that no reading explains, after which the gear itself is taken for another (guess)."""
FREE = 1e3
"""Prior sd of what may take any value."""
STILL = 1e-3
"""Speed over the other encoder's, below which an encoder stands still (guess)."""
FOLLOWS = 0.9
"""Correlation of two speeds, above which they are of one motion (guess)."""


class Cause(NamedTuple):
    """What explains a contradiction."""

    key: str
    channels: tuple[str, ...]
    """those to look at; both where nobody can tell them apart"""
    text: str


GEAR = Cause("gear", (), "")
"""The gear itself has changed, which is no matter of the readings."""


class _Hypothesis(NamedTuple):
    """A row: which unknowns of the twist it sets free, and how it is told."""

    key: str
    frees: Some
    told: Callable[[Array], str]
    """of the solved unknowns' shifts"""


HYPOTHESES = (
    _Hypothesis(
        "skew",
        (SKEW,),
        lambda shift: (
            f"are sampled {1e3 * abs(shift[SKEW]):.3g} ms further apart than before: check latch, trigger "
            "and time stamps"
        ),
    ),
    _Hypothesis(
        "scale",
        (SLOPE,),
        lambda shift: f"turn in another ratio than before, by {shift[SLOPE]:+.2%}: check counts_per_turn and couplings",
    ),
)
"""Ways in which two encoders err together, simplest first; the first that explains enough is believed."""


class _Seen(NamedTuple):
    """Sums over one block."""

    moments: Array
    """(UNKNOWNS + 1, UNKNOWNS + 1) of the columns and the twist"""
    speeds: Array
    """(2, 2) of motor, seen from the output, and output [rad^2/s^2]"""
    rows: int
    duration_s: float


class ReadingWatch:
    """Of one drive with two encoders: `see` every stretch, before anything learns from it."""

    def __init__(self, ratio: float) -> None:
        self._ratio = abs(ratio)
        self._usual_rad2, self._usual_held_rad2, self._usual_s = math.nan, math.nan, 0.0
        self.forget()

    def forget(self) -> None:
        """Nothing contradicts anything."""
        self.turned_rad = 0.0
        """by how much more the motor's angle counted after the newest contradiction than before it, within a turn"""
        self.contradicts = False
        """whether the newest block that said anything does"""
        self.lasting_s = 0.0
        """how long the readings have contradicted the gear; 0 once they agree again"""
        self.cause: Cause | None = None
        self._good_s = 0.0
        self._good: list[_Seen] = []
        self._origin_rad = math.nan
        self._known, self._stiffness = np.full(COLUMNS, math.nan), math.nan
        self._window: deque[_Seen] = deque(maxlen=NEWEST_BLOCKS)
        self._newest: deque[_Seen] = deque(maxlen=LEAP_BLOCKS)
        self._leaps, self._held_rad2 = False, math.nan
        """whether the kinematic error has leapt, and what the newest blocks leave of it as it was"""

    def suspend(self, duration_s: float) -> None:
        """An encoder's own samples say that it fails: what follows is to be found as after a contradiction."""
        if self._stiffness > 0:
            self._good_s, self._good, self.cause = 0.0, [], None
            self.lasting_s += duration_s

    def accept(self) -> None:
        """What contradicts is how it is from now on."""
        self.forget()
        self._usual_rad2, self._usual_held_rad2, self._usual_s = math.nan, math.nan, 0.0

    def dump(self) -> dict[str, Any]:
        """What must outlive a restart: how far readings and gear usually are apart."""
        usual_rad2 = {"usual_rad2": self._usual_rad2, "usual_held_rad2": self._usual_held_rad2}
        return {name: value for name, value in usual_rad2.items() if math.isfinite(value)} | {"usual_s": self._usual_s}

    def load(self, state: Mapping[str, Any]) -> None:
        """Take back what `dump` gave; what is absent is to be learned."""
        self.accept()
        self._usual_rad2 = float(state.get("usual_rad2", math.nan))
        self._usual_held_rad2 = float(state.get("usual_held_rad2", math.nan))
        self._usual_s = float(state.get("usual_s", 0.0))

    def see(self, stretch: Stretch, slope: Slope, error_rad: Array, stiffness: float) -> None:
        """`slope` is what was known of the ratio before, `error_rad` of the kinematic error, `stiffness` of the gear
        [N m/rad], NaN for unknown."""
        if self.lasting_s == 0.0 and stiffness > 0 and math.isfinite(float(slope.value.sum())):
            self._known, self._stiffness = slope.value[:COLUMNS], stiffness
        if not self._stiffness > 0 or np.count_nonzero(stretch.valid) < FEWEST_ROWS:
            return
        seen = self._sums(stretch, error_rad)
        prior = self._prior(seen)
        left_rad2 = prior.left(seen) / seen.rows
        self._newest.append(seen)
        self._leaps = len(self._newest) == LEAP_BLOCKS and self._leapt(_joined(self._newest))
        self._judge(seen, left_rad2, prior.wound_rad2)
        if self.contradicts and self.lasting_s > NAMES_AFTER_S:
            self.cause = self._named()
            if self.cause is GEAR or (self.cause.key == UNEXPLAINED and self.lasting_s > GIVES_IN_S):
                self.accept()

    def _prior(self, seen: _Seen, frees: Some = (), held: Some = ()) -> _Prior:
        return _Prior(self._known, self._stiffness, seen, self._usual_rad2, frees, held)

    def _judge(self, seen: _Seen, left_rad2: float, wound_rad2: float) -> None:
        settled = self._usual_s >= SURE_S
        least = max(FAR**2 * self._usual_rad2, SHARE**2 * wound_rad2)
        self._leaps = self._leaps and not left_rad2 > least
        self.contradicts = settled and (left_rad2 > least or self._leaps)
        if self.contradicts:
            self._good_s, self._good = 0.0, []
            if self.lasting_s > 0:  # the block in which it began is of both
                self._window.append(seen)
            self.lasting_s += seen.duration_s
            return
        if self.lasting_s > 0:
            self._good_s += seen.duration_s
            self._good.append(seen)
            if self._good_s < GOOD_S:
                return
            turned_rad = self._turned()
            self.forget()
            self.turned_rad = turned_rad
        share = seen.duration_s / min(self._usual_s + seen.duration_s, USUAL_MEMORY_S)
        before = self._usual_rad2 if math.isfinite(self._usual_rad2) else left_rad2
        self._usual_rad2 = before + share * (left_rad2 - before)
        if math.isfinite(self._held_rad2):
            before = self._usual_held_rad2 if math.isfinite(self._usual_held_rad2) else self._held_rad2
            self._usual_held_rad2 = before + share * (self._held_rad2 - before)
        self._usual_s += seen.duration_s

    def _leapt(self, seen: _Seen) -> bool:
        """Whether an order of the kinematic error is of another size than it was: wear takes hours to do that, and
        another zero of the motor's encoder turns all orders and leaves them their sizes."""
        held, free = self._prior(seen, held=PHASES), self._prior(seen)
        self._held_rad2 = held.left(seen) / seen.rows
        turned_rad = self._ratio * math.sqrt(seen.speeds[0, 0] / seen.rows) * seen.duration_s
        least = max(FAR**2 * self._usual_held_rad2, SHARE**2 * held.wound_rad2)
        if turned_rad < LEAP_RAD or not self._held_rad2 > least:
            return False
        known, now = (np.hypot(*whole[WAVES].reshape(-1, 2).T) for whole in (self._known, free.solve(seen)))
        return bool(np.abs(now - known).max() > LEAPS * max(float(known.max()), LEAST_WAVE_RAD))

    def _turned(self) -> float:
        """Shift of the motor's zero [rad] that brings the kinematic error back into phase; 0 where none is needed."""
        whole = _joined(self._good)

        def left(turn_rad: float) -> float:
            known = self._known.copy()
            known[WAVES] = turned(known[WAVES], turn_rad)
            return _Prior(known, self._stiffness, whole, self._usual_rad2, (), PHASES).left(whole)

        here, step_rad = left(0.0), 2 * math.pi / TURNS
        first = min((i * step_rad for i in range(TURNS)), key=left)
        best = minimize_scalar(left, bounds=(first - step_rad, first + step_rad), method="bounded")
        return float(best.x) if here > TOLD_APART * float(best.fun) else 0.0

    def _sums(self, stretch: Stretch, error_rad: Array) -> _Seen:
        motion = stretch.motion
        square = motion.torque_Nm**2
        rows = stretch.valid & (square >= LOADED**2 * float(square[stretch.valid].mean()))
        if self.lasting_s == 0.0:
            self._origin_rad = float(motion.theta_out_rad[0])
        rate = motion.twist_rate_rad_s + stretch.kinematic_rate @ error_rad
        joined = np.empty((len(motion), UNKNOWNS + 1))
        joined[:, SLOPE] = motion.theta_out_rad - self._origin_rad
        joined[:, LEVEL] = 1.0
        joined[:, COMPLIANCE] = motion.torque_Nm
        joined[:, LAG] = motion.twist_rate_rad_s
        joined[:, SKEW] = motion.velocity_out_rad_s + motion.twist_rate_rad_s
        joined[:, WAVES] = stretch.kinematic
        joined[:, GAP] = np.sign(motion.torque_Nm)
        joined[:, DRY] = np.sign(rate)
        joined[:, RATES] = stretch.kinematic_rate
        joined[:, UNKNOWNS] = motion.twist_rad + stretch.zero_rad
        motor = motion.velocity_out_rad_s + motion.twist_rate_rad_s
        both = np.stack((motor, motion.velocity_out_rad_s))[:, rows]
        joined = joined[rows]
        return _Seen(joined.T @ joined, both @ both.T, len(joined), len(motion) / motion.rate_hz)

    def _named(self) -> Cause:
        """The simplest that explains the window; else that nothing does."""
        whole = _joined(self._window)
        plain = _of_speeds(whole.speeds, self._ratio)
        if plain is not None:
            return plain
        if self._leaps:
            return Cause(
                "eccentric",
                (MOTOR,),
                f"{MOTOR} errs with its angle by more than before, as no gear does from one second to the next: check "
                "that its disc sits firmly on the shaft",
            )
        base = self._prior(whole).left(whole)
        for row in HYPOTHESES:
            prior = self._prior(whole, row.frees)
            if prior.left(whole) < EXPLAINED * base:
                text = f"{MOTOR} and {OUT} {row.told(prior.solve(whole)[:COLUMNS] - self._known)}"
                return Cause(row.key, BOTH, text)
        if base < GEARS_SHARE * self._prior(whole, held=GEARS).left(whole):
            return GEAR
        return Cause(
            UNEXPLAINED,
            BOTH,
            f"{MOTOR} and {OUT} contradict what is known of the gear, and neither a shift in time nor another scale "
            "explains it: check both encoders, their mounts, the load and the gear",
        )


def _joined(blocks: Iterable[_Seen]) -> _Seen:
    """Sums over several blocks."""
    moments, speeds, rows, duration_s = zip(*blocks, strict=True)
    return _Seen(np.sum(moments, axis=0), np.sum(speeds, axis=0), sum(rows), sum(duration_s))


class _Prior:
    """What is believed of the unknowns before a block: the gear may have changed, the encoders only where `frees`."""

    def __init__(self, known: Array, stiffness: float, seen: _Seen, usual_rad2: float, frees: Some, held: Some) -> None:
        torque_Nm2 = float(seen.moments[COMPLIANCE, COMPLIANCE]) / seen.rows
        self.wound_rad2 = torque_Nm2 / stiffness**2
        """mean square of the twist that the torque makes"""
        self._mean = np.zeros(UNKNOWNS)
        self._mean[:COLUMNS] = known
        self._mean[LEVEL] = 0.0
        sd = np.full(UNKNOWNS, FREE)
        sd[COMPLIANCE], sd[LAG] = OWN_SHARE / stiffness, LAG_SD_S
        waves = float(np.abs(known[WAVES]).max())
        sd[RATES] = max(abs(float(known[LAG])), LEAST_LAG_S) * max(waves, LEAST_WAVE_RAD)
        sd[GAP], sd[DRY] = GAP_SD_RAD, OWN_SHARE * math.sqrt(self.wound_rad2)
        fixed = [i for i in (SLOPE, SKEW) if i not in frees]
        sd[[*fixed, *held]] = 0.0
        self._free = sd > 0
        noise_rad2 = usual_rad2 if math.isfinite(usual_rad2) else self.wound_rad2
        self._weight = noise_rad2 / sd[self._free] ** 2

    def solve(self, seen: _Seen) -> Array:
        """(UNKNOWNS,) most likely values."""
        free, moments = self._free, seen.moments
        right = moments[:-1, -1] - moments[:-1, :-1][:, ~free] @ self._mean[~free]
        matrix = moments[:-1, :-1][np.ix_(free, free)] + np.diag(self._weight + 1e-12 * moments.diagonal()[:-1][free])
        value = self._mean.copy()
        value[free] = np.linalg.solve(matrix, right[free] + self._weight * self._mean[free])
        return value

    def left(self, seen: _Seen) -> float:
        """Sum of squares [rad^2] that the most likely values leave, what they cost included."""
        value = self.solve(seen)
        rest = np.append(-value, 1.0)
        moved = (value - self._mean)[self._free]
        return max(float(rest @ seen.moments @ rest), 0.0) + float(self._weight @ moved**2)


def _of_speeds(speeds: Array, ratio: float) -> Cause | None:
    """A cause so plain that the two speeds show it."""
    motor, out, both = math.sqrt(speeds[0, 0]), math.sqrt(speeds[1, 1]), float(speeds[0, 1])
    follows = abs(both) > FOLLOWS * motor * out > 0
    if follows and 0.5 < motor / out * ratio**2 < 2.0:
        return Cause("exchanged", BOTH, f"{MOTOR} and {OUT} have changed places: check the wiring and node numbers")
    for channel, own, other in ((OUT, out, motor), (MOTOR, motor, out)):
        if own < STILL * other:
            text = f"{channel} stands still while the drive moves: check the encoder, its cable and its coupling"
            return Cause("frozen", (channel,), text)
    if follows and both < 0 and 0.9 < motor / out < 1.1:
        return Cause("flipped", BOTH, f"{MOTOR} or {OUT} counts backward: check `reverse` and the encoder's direction")
    return None

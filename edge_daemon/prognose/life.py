"""The life of one drive's gear, followed block by block: load cycles, damage and remaining life.

Life counts in hours that were observed, so a jump of the clock changes nothing. The forecast itself costs about a tenth
of a second and is renewed once per `FORECAST_EVERY_H`: by `update`, or, when the caller keeps its loop free, by
running the task of `forecast_task` elsewhere and handing the result to `accept`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping

import msgspec
import numpy as np

from edge_daemon.prognose.forecast import MAKERS, Forecast, Prior, foresee
from edge_daemon.prognose.history import KNOWN_AFTER_H, unused
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import Array, Block, Estimate, Status
from edge_daemon.usage import ledger as ledgers
from edge_daemon.usage.cycles import CycleCounter
from edge_daemon.usage.damage import counted
from edge_daemon.usage.evidence import evidence_of
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import NOISE, Ledger

ROW_H = 1.0
"""A row of the ledger closes after this much observed time."""
FORECAST_EVERY_H = 1.0
CYCLE_STEPS_PER_RATED = 1000.0
"""The cycle counter resolves a thousandth of the rated torque, finer than any torque sensor in use."""
CYCLE_STEP_NM = 0.05
"""The cycle counter resolves this much where the size of the gear is unknown."""
SINE_CUBIC_OVER_RMS = 1.063
"""Cubic mean over rms of a sine, (4/(3 pi))^(1/3) sqrt(2), is used where only the rms is known."""

TURN_RAD = 2.0 * math.pi
UNSEEN_SHARE = 0.01
"""Turns are no count any more when more than this share of the motion was not seen (guess)."""
BLOCK_S = 0.1
"""Operating time is known to about a block [s]: within one the drive may have begun or ended to move."""
HALF_CYCLE = 0.5
"""The cycle that is going on is open [cycles]."""
STILL_RAD_S = 1.0
"""A motor slower than this stands: noise of its encoder makes up to a hundredth of it (guess)."""
COUNTED_STEPS = 10
"""A load cycle counts in `load_cycles` from this many steps of the cycle counter on: 1 % of the rated torque."""


UNKNOWN_CHANGE = (math.nan, math.nan)
"""Before there is a stiffness to hold it against, its change and the sd of that are not known."""


class _Turns(msgspec.Struct):
    """Turns of one shaft, both directions counted."""

    count: float = 0.0
    variance: float = 0.0
    unseen_s: float = 0.0
    """time of motion in which nothing told them"""

    def add(self, turns: float, size: int, seconds: float) -> None:
        """Those of a block of so many samples, NaN for unknown: one sample more or less is their uncertainty."""
        if math.isnan(turns):
            self.unseen_s += seconds
            return
        self.count += turns
        self.variance += (turns / size) ** 2

    def known(self, moved_s: float) -> bool:
        """Whether nearly all of the motion was seen."""
        return self.unseen_s <= UNSEEN_SHARE * moved_s

    @property
    def sd(self) -> float:
        """Of the count."""
        return math.sqrt(self.variance)


class _Duty(msgspec.Struct):
    """What the drive has done so far."""

    seconds: float = 0.0
    turns: dict[str, _Turns] = msgspec.field(default_factory=lambda: {"in": _Turns(), "out": _Turns()})


class _Hour(msgspec.Struct):
    """The open row: sums over its samples."""

    hours: float = 0.0
    turns: float = 0.0
    cubic_turns: float = 0.0
    peak_Nm: float = math.nan
    heat: float = 0.0
    heat_hours: float = 0.0
    values: dict[str, tuple[float, float]] = msgspec.field(default_factory=dict)
    """condition -> (sum, count)"""


class _State(msgspec.Struct):
    key: tuple[str, str]
    hour: _Hour
    turns: float
    cubic_turns: float
    peak_Nm: float
    ledger: bytes
    cycles: bytes
    duty: _Duty = msgspec.field(default_factory=_Duty)
    change: tuple[float, float] = UNKNOWN_CHANGE


class LifeFollower:
    """`update` with every block; `state` and `restore` carry the life over a restart; `prior` is believed of a past."""

    def __init__(self, gear: Gear | None, drive: str, prior: Callable[[Ledger], Prior] = lambda ledger: MAKERS) -> None:
        self.gear = gear
        self._prior = prior
        self.drive = drive
        step = gear.rated_torque_Nm / CYCLE_STEPS_PER_RATED if gear else CYCLE_STEP_NM
        self.cycles = CycleCounter(step)
        self.ledger = ledgers.empty()
        self.forecast: Forecast | None = None
        self._numbers: tuple[tuple[float, float], ...] = ()
        self.peak_Nm = 0.0
        """largest torque of the whole life"""
        self.hour = _Hour()
        self._duty = _Duty()
        self._change = UNKNOWN_CHANGE
        self._turns = 0.0
        self._cubic_turns = 0.0
        self._forecast_at_h = -math.inf

    @property
    def observed_h(self) -> float:
        """Hours of life that were observed."""
        return float(np.sum(self.ledger.hours)) + self.hour.hours

    @property
    def counted(self) -> str:
        """What the stiffness lost so far does to the damage; empty for an unknown gear."""
        return counted(self.gear, -self._change[0], self._change[1]) if self.gear else ""

    def update(
        self,
        block: Block,
        estimates: Mapping[str, Estimate],
        torque_Nm: Array | None = None,
        background: bool = False,
    ) -> tuple[Estimate, ...]:
        """The quantities of topic `life` and the cubic mean torque, true at the block's end.

        The sd of each of the three remaining lives is that of the whole distribution.

        Output torque is the channel `torque_out_Nm` where valid, else `torque_Nm` (n,), else what `estimates` say.
        Without a gear there is no life: INVALID and NaN. In the first day of load the numbers are the maker's prior:
        WARMING_UP, finite and wide. With `background` the caller renews the forecast through `forecast_task`.
        """
        self._count(block, estimates, torque_Nm)
        if self.hour.hours >= ROW_H:
            self._close_hour()
        if not background:
            task = self.forecast_task()
            if task is not None:
                self.accept(task())
        return self._estimates(block.end_s)

    def forecast_task(self) -> Callable[[], Forecast] | None:
        """The forecast to run, in any thread, if one is due; None if not or if the gear is unknown."""
        hours = self.observed_h
        if self.gear is None or hours < self._forecast_at_h + FORECAST_EVERY_H:
            return None
        self._forecast_at_h = hours
        evidence = evidence_of(self.ledger) if len(self.ledger) else unused(self.gear)
        return functools.partial(foresee, self.gear, self.ledger, evidence, self._prior(self.ledger))

    def renew(self) -> None:
        """The forecast is due: what is believed has changed."""
        self._forecast_at_h = -math.inf

    def accept(self, result: Forecast) -> None:
        """Take over what a forecast task returned."""
        self.forecast = result
        left = float(np.std(result.remaining_h))
        used = (float(np.median(result.fatigue_used)), float(np.std(result.fatigue_used)))
        self._numbers = (used, *((result.quantile_h(q), left) for q in (0.1, 0.5, 0.9)))

    def state(self) -> bytes:
        """Everything that `restore` needs; about 20 kB after years."""
        saved = _State(
            (self.drive, self.gear.name if self.gear else ""),
            self.hour,
            self._turns,
            self._cubic_turns,
            self.peak_Nm,
            ledgers.to_bytes(self.ledger),
            self.cycles.state(),
            self._duty,
            self._change,
        )
        return msgspec.msgpack.encode(saved)

    def restore(self, blob: bytes) -> bool:
        """True if the life was taken over; False, and nothing changed, if broken or of another drive or gear."""
        try:
            saved = msgspec.msgpack.decode(blob, type=_State)
        except msgspec.MsgspecError:
            return False
        ledger = ledgers.from_bytes(saved.ledger)
        if saved.key != (self.drive, self.gear.name if self.gear else "") or ledger is None:
            return False
        if not self.cycles.restore(saved.cycles):
            return False
        self.ledger, self.hour, self._duty = ledger, saved.hour, saved.duty
        self._turns, self._cubic_turns, self.peak_Nm = saved.turns, saved.cubic_turns, saved.peak_Nm
        self._change = saved.change
        self.renew()
        return True

    def _count(self, block: Block, estimates: Mapping[str, Estimate], torque_Nm: Array | None) -> None:
        hour, hours = self.hour, block.size / block.rate_hz / 3600.0
        torque = _torque(block, estimates, torque_Nm)
        speed = _speed_in_rad_s(block, estimates, self.gear)
        hour.hours += hours
        self._follow_duty(block, estimates, speed)
        if torque.size:
            self.cycles.update(torque)
            known = np.abs(torque[np.isfinite(torque)])
            if known.size:
                turns = speed / (2.0 * math.pi) * hours * 3600.0 * known.size / max(torque.size, 1)
                cubic = float(np.dot(known * known, known)) / known.size * turns
                hour.turns += turns
                hour.cubic_turns += cubic
                self._turns += turns
                self._cubic_turns += cubic
                peak = float(np.max(known))
                hour.peak_Nm = peak if math.isnan(hour.peak_Nm) else max(hour.peak_Nm, peak)
                self.peak_Nm = max(self.peak_Nm, peak)
        warm = estimates.get("temperature")
        if warm is not None and warm.usable:
            hour.heat += warm.value * hours
            hour.heat_hours += hours
        change = estimates.get("stiffness_change")
        if change is not None and change.status is Status.VALID and change.usable:
            self._change = (change.value, change.sd)
        for name, column in (("stiffness", "stiffness_Nm_per_rad"), *((name, name) for name in NOISE)):
            if (estimate := estimates.get(name)) and estimate.status is Status.VALID and estimate.usable:
                total, count = hour.values.get(column, (0.0, 0.0))
                hour.values[column] = (total + estimate.value, count + 1.0)

    def _follow_duty(self, block: Block, estimates: Mapping[str, Estimate], speed_in_rad_s: float) -> None:
        """Time and turns of a drive that moves; what one sample more or less makes is their uncertainty."""
        duty, seconds = self._duty, block.size / block.rate_hz
        if not speed_in_rad_s > STILL_RAD_S:
            return
        duty.seconds += seconds
        ratio = estimates.get("ratio")
        slower = abs(ratio.value) if ratio and ratio.usable else self.gear.ratio if self.gear else math.nan
        turns_in, turns_out = (_turns(block, side) for side in ("in", "out"))
        turns_in = turns_out * slower if math.isnan(turns_in) else turns_in
        turns_out = turns_in / slower if math.isnan(turns_out) else turns_out
        for side, turns in (("in", turns_in), ("out", turns_out)):
            duty.turns[side].add(turns, block.size, seconds)

    def _duty_estimates(self, time_s: float) -> tuple[Estimate, ...]:
        duty = self._duty
        ranges, counts = self.cycles.cycles()
        counted = float(counts[ranges >= (COUNTED_STEPS - 0.5) * self.cycles.resolution_Nm].sum())
        rows = [
            ("operating_hours", duty.seconds / 3600.0, BLOCK_S / 3600.0, True),
            *((f"turns_{side}", row.count, row.sd, row.known(duty.seconds)) for side, row in duty.turns.items()),
            ("load_cycles", counted, HALF_CYCLE, True),
        ]
        return tuple(
            Estimate(name, value, sd, QUANTITIES[name].unit, Status.VALID if known else Status.INVALID, time_s)
            for name, value, sd, known in rows
        )

    def _close_hour(self) -> None:
        hour, self.hour = self.hour, _Hour()
        if self.gear is None:
            self.ledger = ledgers.empty()
            return
        end_h = float(self.ledger.end_h[-1]) + hour.hours if len(self.ledger) else hour.hours
        columns = {name: np.array([total / count]) for name, (total, count) in hour.values.items()}
        mean = (hour.cubic_turns / hour.turns) ** (1 / 3) if hour.turns > 0.0 else 0.0
        columns["torque_cubic_mean_Nm"] = np.array([mean])
        columns["torque_peak_Nm"] = np.array([hour.peak_Nm])
        columns["speed_in_rpm"] = np.array([hour.turns / (60.0 * hour.hours)])
        columns["temperature_degC"] = np.array([hour.heat / hour.heat_hours if hour.heat_hours else math.nan])
        columns["stiffness_change"], columns["stiffness_change_sd"] = (np.array([one]) for one in self._change)
        row = ledgers.rows_of(self.gear, np.array([end_h]), np.array([hour.hours]), columns)
        self.ledger = ledgers.join(self.ledger, row)

    def _estimates(self, time_s: float) -> tuple[Estimate, ...]:
        mean = (self._cubic_turns / self._turns) ** (1 / 3) if self._turns > 0.0 else math.nan
        known = Status.VALID if self._turns > 0.0 else Status.INVALID
        load = Estimate("torque_cubic_mean", mean, 0.0 if self._turns else math.nan, "N m", known, time_s)
        names = ("damage", "rul_p10_h", "rul_p50_h", "rul_p90_h")
        told = Status.VALID if self.observed_h >= KNOWN_AFTER_H else Status.WARMING_UP
        status = told if self._numbers else Status.INVALID
        rows = zip(names, self._numbers or ((math.nan, math.nan),) * len(names), strict=True)
        return (
            *(Estimate(n, v, sd, QUANTITIES[n].unit, status, time_s) for n, (v, sd) in rows),
            load,
            *self._duty_estimates(time_s),
        )


def _torque(block: Block, estimates: Mapping[str, Estimate], torque_Nm: Array | None) -> Array:
    """(n,) output torque [N m], NaN where unknown; empty if nothing is known."""
    if "torque_out_Nm" in block.values:
        good = block.valid("torque_out_Nm")
        if good.any():
            return np.where(good, block.values["torque_out_Nm"], np.nan)
    if torque_Nm is not None and np.isfinite(torque_Nm).any():
        return np.asarray(torque_Nm, dtype=float)
    rms = estimates.get("torque_rms")
    if rms is not None and rms.usable:
        return np.full(block.size, SINE_CUBIC_OVER_RMS * rms.value)
    return np.empty(0)


def _speed_in_rad_s(block: Block, estimates: Mapping[str, Estimate], gear: Gear | None) -> float:
    """Mean magnitude of the wave generator's speed [rad/s]; 0 if nothing tells it."""
    ratio = gear.ratio if gear else 1.0
    for channel, factor in (("velocity_in_rad_s", 1.0), ("velocity_out_rad_s", ratio)):
        if channel in block.values:
            good = block.valid(channel)
            if good.any():
                return float(np.mean(np.abs(block.values[channel][good]))) * factor
    for channel, factor in (("theta_in_rad", 1.0), ("theta_out_rad", ratio)):
        travel = _travel_rad(block, channel)
        if math.isfinite(travel):
            return travel * block.rate_hz / block.size * factor
    estimate = estimates.get("speed_in")
    return abs(estimate.value) if estimate is not None and estimate.usable else 0.0


def _turns(block: Block, side: str) -> float:
    """Turns of the shaft `in` or `out` during the block, from its encoder or its drive's speed; NaN where unknown."""
    travel = _travel_rad(block, f"theta_{side}_rad")
    speed = f"velocity_{side}_rad_s"
    if math.isnan(travel) and speed in block.values and block.valid(speed).any():
        travel = float(np.mean(np.abs(block.values[speed][block.valid(speed)]))) * block.size / block.rate_hz
    return travel / TURN_RAD


def _travel_rad(block: Block, channel: str) -> float:
    """How far an angle went during the block, both directions counted; NaN where it is not measured."""
    if channel not in block.values:
        return math.nan
    angle = block.values[channel][block.valid(channel)]
    if angle.size < 2:
        return math.nan
    return float(np.sum(np.abs(np.diff(angle)))) * block.size / (angle.size - 1)

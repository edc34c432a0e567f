"""Damage and remaining life from a gear's history, one row an hour or so.

Columns as in docs/recordings.md: `speed_in_rpm`, `torque_cubic_mean_Nm`, `torque_peak_Nm` and, where known,
`temperature_degC`, `stiffness_Nm_per_rad`, `noise_a0` to `noise_a4`. What is missing is assumed and said; what cannot
be true is refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from edge_daemon.errors import BadInput
from edge_daemon.prognose.courses import LifeCourse
from edge_daemon.prognose.experience import MONTH_H, explained
from edge_daemon.prognose.forecast import MAKERS, Forecast, Prior, forecast, foresee
from edge_daemon.records import NE107, Array
from edge_daemon.usage.bearing import HOT_DEGC
from edge_daemon.usage.damage import counted
from edge_daemon.usage.evidence import Evidence, evidence_of
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import CONDITIONS, Ledger, empty, lost_stiffness, rows_of

MOST_SPEED_RPM = 30_000.0
"""Four times what makers allow for the smallest size is a unit error, not a speed."""
MOST_OVERLOAD = 5.0
"""So many times the buckling (or momentary) torque is a unit error, not a load."""
TEMPERATURE_DEGC = (-60.0, 200.0)
"""Outside, no grease works and no steel keeps its temper: it is a broken sensor."""
LONGEST_GAP_STEPS = 3.0
"""A longer step between two rows is a gap; what happened in it is unknown."""
LONGEST_JUMP_H = 10 * 8766.0
"""Ten years between two rows are a clock error."""
CALENDAR_H = 200_000.0
"""A history that starts later than this counts from a calendar's epoch, not from the gear's first hour."""
MOST_GUESSED = 0.5
"""The answer needs a check of the sensors beyond this share of hours with assumed load."""
MEAN_OVER_PEAK = 0.6
"""Cubic mean over peak torque of a usual cycle of start, run and stop (guess: between the limits' own 0.5 and 0.65)."""
ROUNDED = 0.01
"""Two loggers may round a mean and a peak differently by this share (guess)."""
SPIKE_WINDOW = 25
SPIKE_SD = 6.0
"""A condition this many robust sd from the running median of its neighbours is a spike, and is left out."""
KNOWN_AFTER_H = 24.0
"""Before a day of observed load the numbers are the maker's prior, and the answer says so (guess)."""
HORIZONS_H = (24.0, 168.0, 720.0, 2190.0, 4383.0, 8766.0, 17532.0, 43830.0)
"""A day, a week, a month, a quarter, half a year, one, two and five years."""
SOON_PROBABILITY = 0.1
"""Maintenance is due when the chance of failure within a month exceeds this."""
USED_UP = 0.8
"""A technician should know from this share of a capacity on."""


class LifeError(BadInput):
    """One line: which column and row, what is wrong, what was expected."""


@dataclass(frozen=True, slots=True)
class LifeReport:
    """Where the gear stands at `time_h`."""

    time_h: float
    damage: float
    """share of the flexspline's fatigue life that is used, median"""
    p10_h: float
    p50_h: float
    p90_h: float
    """remaining life that 90, 50 and 10 % of such gears exceed"""
    failure_probability: tuple[tuple[float, float], ...]
    """(within [h], probability)"""
    state: NE107
    reasons: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The life JSON; every number is finite."""
        return {
            "time_h": self.time_h,
            "damage": self.damage,
            "rul_h": {"p10": self.p10_h, "p50": self.p50_h, "p90": self.p90_h},
            "failure_probability": [{"within_h": h, "probability": p} for h, p in self.failure_probability],
            "state": self.state.name.lower(),
            "reasons": list(self.reasons),
        }


def life_of_history(
    time_h: Array,
    columns: Mapping[str, Array],
    gear: Gear,
    load_factor: float = 1.0,
    prior: Prior = MAKERS,
    repairs: Sequence[str] = (),
) -> LifeReport:
    """Damage and remaining life after a history.

    `load_factor` plans other torque for the time to come (1.2 = 20 % more); `prior` may be one that `learn` has made
    from gears that failed; `repairs` are what reading the file had to mend, told with the reasons. Raises `LifeError`
    for what cannot be a history: unsorted or non-finite time, negative torque, absurd values.
    """
    time_h, columns, found = _checked(np.asarray(time_h, dtype=float), columns, gear)
    notes = [*repairs, *found]
    if prior.experience is not None and prior.experience.gear != gear.name:
        raise LifeError(f"the prior was learned from gears of {prior.experience.gear}: this is a {gear.name}")
    if load_factor != 1.0:
        notes.append(f"plan: {load_factor:g} times the torque from now on")
    if not time_h.size:
        evidence = unused(gear, load_factor)
        notes.append(f"no history: the maker's expectation for {gear.name} at rated torque and speed")
        return report(gear, empty(), evidence, forecast(gear, evidence, prior), 0.0, notes)
    hours, before_h = _durations(time_h, notes)
    columns = _filled(columns, gear, notes)
    ledger = rows_of(gear, time_h, hours, columns)
    evidence = evidence_of(ledger, before_h, load_factor)
    lost, sd = lost_stiffness(columns, time_h.size)
    if math.isfinite(lost[-1]):
        notes.append(counted(gear, float(lost[-1]), float(sd[-1])))
    if float(np.sum(hours)) < KNOWN_AFTER_H:
        notes.append(f"only {float(np.sum(hours)):.3g} h of history: this is the maker's expectation for {gear.name}")
    elif evidence.stiffness is None and evidence.noise is None:
        notes.append("no stiffness or noise in the history: the forecast is the maker's life under this load")
    else:
        seen = "; ".join(f"{name} {change:+.1%}" for name, change in _changes(columns))
        notes.append(f"the forecast is of this load and of what changed from the first to the last tenth: {seen}")
    if prior.experience is not None:
        notes.append(explained(prior.experience, LifeCourse(ledger, prior.experience.scales, before_h)))
    future = foresee(gear, ledger, evidence, prior, before_h, load_factor)
    return report(gear, ledger, evidence, future, float(time_h[-1]), notes)


def _changes(columns: Mapping[str, Array]) -> Iterator[tuple[str, float]]:
    """Each condition's median over the last tenth of its rows against that over the first."""
    for name in CONDITIONS:
        known = columns.get(name, np.empty(0))
        known = known[np.isfinite(known)]
        few = max(len(known) // 10, 1)
        if len(known) >= 2:
            yield name.partition("_Nm_")[0], float(np.median(known[-few:]) / np.median(known[:few])) - 1.0


def usable(time_h: Array, columns: Mapping[str, Array], gear: Gear) -> tuple[Array, dict[str, Array]]:
    """Time and columns as `life_of_history` takes them: checked, unknown load assumed, spikes left out."""
    time_h, kept, notes = _checked(np.asarray(time_h, dtype=float), columns, gear)
    return time_h, _filled(kept, gear, notes) if time_h.size else kept


def unused(gear: Gear, load_factor: float = 1.0) -> Evidence:
    """Evidence of a gear without a past, expected to run at rated torque and speed."""
    one = np.ones(1)
    columns = {"speed_in_rpm": one * gear.rated_speed_rpm, "torque_cubic_mean_Nm": one * gear.rated_torque_Nm}
    hour = evidence_of(rows_of(gear, one, one, columns), 0.0, load_factor)
    rated_h, strain_h = np.zeros_like(hour.rated_h), np.zeros_like(hour.strain_h)
    return replace(hour, age_h=0.0, rated_h=rated_h, rated_now_h=0.0, strain_h=strain_h, stiffness=None)


def report(
    gear: Gear, ledger: Ledger, evidence: Evidence, future: Forecast, time_h: float, notes: list[str]
) -> LifeReport:
    """The forecast in a technician's words."""
    p10, p50, p90 = (future.quantile_h(q) for q in (0.1, 0.5, 0.9))
    state, reasons = _judge(gear, ledger, future)
    doubtful = any(note.startswith("check") for note in notes)
    return LifeReport(
        time_h,
        float(np.median(future.fatigue_used)),
        p10,
        p50,
        p90,
        tuple((within, future.failure_probability(within)) for within in HORIZONS_H),
        max(state, NE107.FUNCTION_CHECK) if doubtful else state,
        (*reasons, *notes),
    )


def _judge(gear: Gear, ledger: Ledger, future: Forecast) -> tuple[NE107, list[str]]:
    state, reasons = NE107.OK, []
    soon = future.failure_probability(MONTH_H)
    weaker = "wave generator bearing" if float(np.mean(future.bearing_first)) > 0.5 else "flexspline"
    if soon > SOON_PROBABILITY:
        state = NE107.MAINTENANCE_REQUIRED
        reasons.append(
            f"{soon:.0%} chance of failure within {MONTH_H:.0f} h, most likely the {weaker}: plan replacement"
        )
    for part, used in (("flexspline", future.fatigue_used), ("wave generator bearing", future.bearing_used)):
        share = float(np.median(used))
        if share > USED_UP:
            state = NE107.MAINTENANCE_REQUIRED
            reasons.append(f"{share:.0%} of the {part}'s life is used (median): order a spare gear")
    if len(ledger):
        hot_h = float(np.sum(ledger.hours[ledger.temperature_degC > HOT_DEGC]))
        if hot_h:
            state = max(state, NE107.OUT_OF_SPECIFICATION)
            reasons.append(
                f"{hot_h:.0f} h above the grease's limit of {HOT_DEGC:.0f} degC: cool the gear, renew the grease"
            )
        overload = _overload(gear, float(np.max(ledger.peak_Nm)))
        if overload:
            state = max(state, NE107.OUT_OF_SPECIFICATION)
            reasons.append(overload)
    return state, reasons


def _overload(gear: Gear, peak_Nm: float) -> str:
    """The highest limit that the peak has passed; empty if none. Repeated peaks are within normal use."""
    passed = [row for row in gear.limits if peak_Nm > row[1] and row[0] != "repeated peak"]
    if not passed:
        return ""
    name, limit = passed[-1]
    return f"peak torque {peak_Nm:.0f} N m passed the {name} limit of {limit:.0f} N m: inspect the gear, lower the load"


def _checked(time_h: Array, columns: Mapping[str, Array], gear: Gear) -> tuple[Array, dict[str, Array], list[str]]:
    """Sorted time without duplicates, the columns beside it, and what had to be left out."""
    if time_h.ndim != 1:
        raise LifeError("time_h: expected one number per row")
    for name, values in columns.items():
        if np.shape(values) != time_h.shape:
            raise LifeError(f"{name}: {np.size(values)} values for {time_h.size} rows of time_h")
    if not np.isfinite(time_h).all():
        raise LifeError(f"time_h: row {int(np.argmin(np.isfinite(time_h))) + 1} is not a number")
    if time_h.size and time_h[0] < 0.0:
        raise LifeError(f"time_h: starts at {time_h[0]:g}: expected hours since the gear was new, not negative")
    steps = np.diff(time_h)
    if (steps < 0.0).any():
        row = int(np.argmax(steps < 0.0)) + 2
        raise LifeError(f"time_h: row {row} runs backward from {time_h[row - 2]:g} to {time_h[row - 1]:g}")
    if (steps > LONGEST_JUMP_H).any():
        row = int(np.argmax(steps > LONGEST_JUMP_H)) + 2
        raise LifeError(f"time_h: row {row} jumps by {steps[row - 2]:g} h: expected rows an hour or so apart")
    notes: list[str] = []
    new = np.append(True, steps > 0.0)[: time_h.size]
    if not new.all():
        notes.append(f"{int(np.sum(~new))} rows repeat the time of the row before and were left out")
    kept = {name: np.asarray(values, dtype=float)[new] for name, values in columns.items()}
    _refuse_absurd(kept, gear)
    return time_h[new], kept, notes


def _refuse_absurd(columns: Mapping[str, Array], gear: Gear) -> None:
    most_torque = MOST_OVERLOAD * (gear.buckling_Nm or gear.momentary_peak_Nm or 10.0 * gear.rated_torque_Nm)
    bounds = {
        "speed_in_rpm": (-MOST_SPEED_RPM, MOST_SPEED_RPM, "rpm"),
        "torque_cubic_mean_Nm": (0.0, most_torque, "N m"),
        "torque_peak_Nm": (0.0, most_torque, "N m"),
    }
    for name, (low, high, unit) in bounds.items():
        values = columns.get(name)
        if values is None:
            continue
        wrong = (values < low) | (values > high)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise LifeError(f"{name}: row {row + 1} is {values[row]:g}: expected {low:g} to {high:g} {unit}")


def _durations(time_h: Array, notes: list[str]) -> tuple[Array, float]:
    """Hours that each row covers, and hours that the gear ran before the first row."""
    steps = np.diff(time_h)
    usual = float(np.median(steps)) if steps.size else min(max(float(time_h[0]), 1e-3), 1.0)
    hours = np.concatenate(([usual], steps))
    gaps = hours > LONGEST_GAP_STEPS * usual
    if gaps.any():
        lost_h = float(np.sum(hours[gaps]))
        notes.append(f"{int(np.sum(gaps))} gaps of {lost_h:.0f} h altogether: the load of the row after is assumed")
    before_h = max(float(time_h[0]) - usual, 0.0)
    if before_h > CALENDAR_H:
        notes.append(f"time starts at {time_h[0]:.0f} h: taken for a calendar, the gear as new at the first row")
        return hours, 0.0
    if before_h > LONGEST_GAP_STEPS * usual:
        notes.append(f"no rows before {time_h[0]:.0f} h: the mean load of the history is assumed for that time")
    return hours, before_h


def _filled(columns: Mapping[str, Array], gear: Gear, notes: list[str]) -> dict[str, Array]:
    """The columns with unknown load assumed, and broken conditions left out."""
    filled = {name: np.where(np.isfinite(values), values, np.nan) for name, values in columns.items()}
    size = next((values.shape for values in filled.values()), (1,))
    mean, peak = (filled.get(name, np.full(size, np.nan)) for name in ("torque_cubic_mean_Nm", "torque_peak_Nm"))
    if np.any(np.isnan(mean) & np.isfinite(peak)):
        notes.append(f"torque_cubic_mean_Nm unknown for some rows: {MEAN_OVER_PEAK:g} of the peak is assumed there")
    filled["torque_cubic_mean_Nm"] = _assumed(
        "torque", np.where(np.isnan(mean), MEAN_OVER_PEAK * peak, mean), gear.rated_torque_Nm, "N m", notes
    )
    exchanged = peak < (1 - ROUNDED) * mean
    if exchanged.any():
        notes.append(
            f"check the columns: torque_peak_Nm is below torque_cubic_mean_Nm in {int(np.sum(exchanged))} rows, "
            "which no peak can be: are they exchanged?"
        )
    filled["torque_peak_Nm"] = np.where(np.isnan(peak), filled["torque_cubic_mean_Nm"], peak)
    speed = np.abs(filled.get("speed_in_rpm", np.full(size, np.nan)))
    filled["speed_in_rpm"] = _assumed("speed", speed, gear.rated_speed_rpm, "rpm", notes)
    warm = filled.get("temperature_degC")
    if warm is not None:
        low, high = TEMPERATURE_DEGC
        filled["temperature_degC"] = np.where((warm > low) & (warm < high), warm, np.nan)
    for name in CONDITIONS:
        if name in filled:
            filled[name] = _without_spikes(name, filled[name], notes)
    return filled


def _assumed(what: str, values: Array, rated: float, unit: str, notes: list[str]) -> Array:
    """Unknown values replaced by the mean of the known ones, or by the rated value."""
    known = np.isfinite(values)
    if known.all():
        return values
    share = 1.0 - float(np.mean(known))
    value = float(np.mean(values[known])) if known.any() else rated
    check = "check the sensor: " if share > MOST_GUESSED else ""
    notes.append(f"{check}{what} unknown for {share:.0%} of the rows: {value:.3g} {unit} is assumed there")
    return np.where(known, values, value)


def _without_spikes(name: str, values: Array, notes: list[str]) -> Array:
    """NaN where a condition is not positive or stands out from its neighbours."""
    broken = values <= 0.0
    if broken.any():
        notes.append(f"{name}: {int(np.sum(broken))} rows are not positive and were left out")
    values = np.where(broken, np.nan, values)
    known = np.flatnonzero(np.isfinite(values))
    if known.size < SPIKE_WINDOW:
        return values
    logs = np.log(values[known])
    half = SPIKE_WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(logs, half, mode="reflect"), SPIKE_WINDOW)
    off = np.abs(logs - np.median(windows, axis=1))
    spread = 1.4826 * float(np.median(off))
    spikes = off > SPIKE_SD * max(spread, 1e-6)
    if spikes.any() and math.isfinite(spread):
        notes.append(f"{name}: {int(np.sum(spikes))} spikes were left out")
        values[known[spikes]] = np.nan
    return values

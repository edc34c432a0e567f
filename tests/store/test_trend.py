"""The past as columns: months of hours and a day of seconds, thinned, with gaps, at a bounded price."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.records import NE107, Estimate, Snapshot, Status
from edge_daemon.store.hours import HourMeans
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store
from edge_daemon.store.trend import trend

HOUR = 487_000
"""hours since the epoch at which the seconds begin"""
NOW_S = HOUR * 3600.0
DAYS = 100
DRIVE = "axis"


def snapshot(time_s: float, **values: float) -> Snapshot:
    rows = {name: Estimate(name, value, 0.5, "1", Status.VALID, time_s) for name, value in values.items()}
    rows["rul_p10_h"] = Estimate("rul_p10_h", 9000.0, math.nan, "h", Status.WARMING_UP, time_s)
    rows["damping"] = Estimate("damping", 1.0, 1.0, "1", Status.WARMING_UP, time_s)
    return Snapshot(DRIVE, int(time_s), time_s, NE107.OK, (), rows)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stiffness falls by 1 an hour for 100 days and then by 1 a second for ten minutes; day 50 was a holiday."""
    path = tmp_path_factory.mktemp("trend") / "s.sqlite"
    store = Store(Settings(max_mib=64), path)
    for second in range(600):
        store.add_snapshot(snapshot(NOW_S + second, stiffness=1000.0 - second, torque_peak=5.0))
    store.commit()
    store.close()
    with sqlite3.connect(path) as database:
        (number,) = database.execute("SELECT id FROM drive").fetchone()
        database.execute("DELETE FROM hour")
        for n in range(24 * DAYS):
            if not 50 * 24 <= n < 51 * 24:
                means = HourMeans(HOUR - 24 * DAYS + n, {})
                peak = 99.0 if n == 100 else 5.0
                means.add(snapshot(0.0, stiffness=5000.0 - n - 0.5, torque_peak=1.0))
                means.add(snapshot(0.0, stiffness=5000.0 - n + 0.5, torque_peak=peak))
                database.execute(
                    "INSERT INTO hour (drive, hour, data) VALUES (?, ?, ?)", (number, means.hour, means.encode())
                )
    return path


def found(file: Path, span_s: float, points: int = 200, names: tuple[str, ...] = ("stiffness",)):  # type: ignore[no-untyped-def]
    with StoreReader(file) as reader:
        return trend(reader, DRIVE, names, NOW_S + 600 - span_s, NOW_S + 600, points)


def test_ten_minutes_are_the_newest_of_each_step(file: Path) -> None:
    rows = found(file, 600.0)
    assert rows.time_s - NOW_S == pytest.approx(np.arange(2, 600, 3))
    assert rows.value["stiffness"] == pytest.approx(1000.0 - (rows.time_s - NOW_S))
    assert np.all(rows.sd["stiffness"] == 0.5)


def test_months_are_means_of_hours_over_the_whole_span(file: Path) -> None:
    rows = found(file, DAYS * 86_400.0)
    known = np.isfinite(rows.value["stiffness"])
    assert 180 < known.sum() <= 202
    hourly = known & (rows.time_s < NOW_S)
    hours = (rows.time_s[hourly] - NOW_S) / 3600 + 24 * DAYS - 0.5
    assert hours[0] < 13 and hours[-1] > 24 * DAYS - 13
    assert rows.value["stiffness"][hourly] == pytest.approx(5000.0 - hours, abs=1e-6)


def test_nothing_bridges_the_holiday_and_nothing_else_is_broken(file: Path) -> None:
    fine = found(file, 60 * 86_400.0, 1000)
    (gap,) = np.flatnonzero(~np.isfinite(fine.value["stiffness"]))
    assert 50.0 <= (fine.time_s[gap] - NOW_S) / 86_400 + DAYS <= 51.0


def test_the_one_overload_of_a_hundred_days_is_seen_in_any_span(file: Path) -> None:
    for points in (20, 200, 1000):
        assert np.nanmax(found(file, DAYS * 86_400.0, points, ("torque_peak",)).value["torque_peak"]) == 99.0


def test_a_guess_is_shown_what_warms_up_is_not(file: Path) -> None:
    rows = found(file, 600.0, 200, ("rul_p10_h", "damping"))
    assert np.all(rows.value["rul_p10_h"] == 9000.0) and np.all(np.isnan(rows.value["damping"]))


def test_the_price_does_not_grow_with_what_is_stored(file: Path) -> None:
    """Counted, not timed: a seek per point, however many snapshots lie between."""
    with StoreReader(file) as reader:
        asked: list[str] = []
        reader.database.set_trace_callback(asked.append)
        trend(reader, DRIVE, ("stiffness",), NOW_S - 1e6, NOW_S + 600, 300)
        assert len(asked) < 20, "no step without data is asked for one by one"


NO_SPANS = [(1, 1, 10), (2, 1, 10), (0, math.inf, 10), (0, 1, 1), (0, 1, 10**6)]


@pytest.mark.parametrize(("since", "until", "points"), NO_SPANS)
def test_a_span_that_is_none_is_refused(file: Path, since: float, until: float, points: int) -> None:
    with StoreReader(file) as reader, pytest.raises(ValueError, match="expected"):
        trend(reader, DRIVE, ("stiffness",), since, until, points)


def test_an_unknown_drive_has_no_past(file: Path) -> None:
    with StoreReader(file) as reader:
        assert len(trend(reader, "other", ("stiffness",), NOW_S, NOW_S + 600, 10).time_s) == 0


def test_the_fleets_answer_covers_the_whole_span_too(file: Path) -> None:
    with StoreReader(file) as reader:
        rows = reader.estimates(DRIVE, ["stiffness"], limit=100)
    assert len(rows) <= 101 and (rows[-1].time_s - rows[0].time_s) / 86_400 > DAYS - 1.2

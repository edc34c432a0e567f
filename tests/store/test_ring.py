"""The ring on disk: what goes in comes out, and it stays under its limit."""

from __future__ import annotations

import dataclasses
import math
import sqlite3
import struct
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.config.settings import StoreSettings as Settings
from edge_daemon.records import NE107, Block, Estimate, Event, Flaw, Status
from edge_daemon.store.export import recording_of
from edge_daemon.store.reader import StoreReader
from edge_daemon.store.ring import Store, StoreError, file_bytes
from edge_daemon.store.rows import DAMAGE, names_of, pack_estimates, unpack_estimates
from tests.store.stored import EPOCH_S, SMALL, block, filled, same, snapshot, sound

# in and out


def test_blocks_come_back_to_the_last_bit_in_order_and_by_span(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    given = [block(number) for number in range(50)]
    given[7].values["torque_out_Nm"][3:9] = math.nan
    given[7].flaws["torque_out_Nm"][3:9] = Flaw.MISSING | Flaw.STALE
    for first in range(0, 50, 10):
        for row in given[first : first + 10]:
            store.add_block(row)
            store.add_block(Block("other", row.sequence, row.start_s, 1000.0, row.values, row.flaws))
        store.commit()
    with StoreReader(tmp_path / "s.sqlite") as reader:
        assert reader.drives() == ("axis", "other")
        assert all(same(stored, row) for stored, row in zip(reader.blocks("axis"), given, strict=True))
        some = list(reader.blocks("axis", EPOCH_S + 1.25, EPOCH_S + 1.75))
        assert [row.sequence for row in some] == [12, 13, 14, 15, 16, 17]
        assert reader.newest_s() == given[-1].end_s


def test_estimates_events_and_state_come_back(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    for second in range(100):
        for part in (0.0, 0.25, 0.5, 0.75):
            store.add_snapshot(snapshot(second + part, value=float(second)))
    store.add_snapshot(snapshot(99.8, value=-1.0, state=NE107.FAILURE))
    store.add_event(Event("axis", EPOCH_S, NE107.FAILURE, "theta_in_rad", "silent"))
    store.add_event(Event("", EPOCH_S + 1, NE107.OK, "gateway", "started"))
    store.save_state("axis/estimates", b"\x00\x01")
    assert store.load_state("axis/estimates") == b"\x00\x01"
    store.commit()
    assert store.load_state("axis/estimates") == b"\x00\x01"
    assert store.load_state("nothing") is None
    with StoreReader(tmp_path / "s.sqlite") as reader:
        found = reader.estimates("axis", ["stiffness"])
        assert [row.value for row in found] == [*map(float, range(100)), -1.0]
        assert found[5] == Estimate("stiffness", 5.0, 0.1, "1", Status.VALID, EPOCH_S + 5)
        assert len(reader.estimates("axis", ["stiffness", "damping"], EPOCH_S + 10, EPOCH_S + 20)) == 20
        thinned = reader.estimates("axis", ["stiffness"], limit=10)
        assert 9 <= len(thinned) <= 10
        assert np.ptp(np.diff([row.time_s for row in thinned[:-1]])) <= 2.0
        assert [event.message for event in reader.events()] == ["silent", "started"]
        assert [event.message for event in reader.events(1)] == ["started"]


def test_hourly_means_outlive_the_snapshots(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    start = 3600 - EPOCH_S % 3600  # a full hour
    for i in range(3 * 36):
        store.add_snapshot(snapshot(start + 100 * i, value=float(i)))
        store.commit()
    store.close()
    with sqlite3.connect(tmp_path / "s.sqlite") as database:
        database.execute("DELETE FROM snapshot WHERE time_s < ?", (EPOCH_S + start + 7200,))
    with StoreReader(tmp_path / "s.sqlite") as reader:
        hours = reader.hours("axis")
        assert [row[1]["stiffness"].count for row in hours] == [36, 36, 36]
        first = hours[0][1]["stiffness"]
        assert first.mean == pytest.approx(np.mean(np.arange(36)))
        assert first.squares == pytest.approx(np.var(np.arange(36)) * 36)
        assert (first.lowest, first.highest) == (0.0, 35.0)
        assert "damping" not in hours[0][1], "an estimate that warms up is no mean"
        found = reader.estimates("axis", ["stiffness"])
        assert [row.value for row in found[:2]] == [pytest.approx(17.5), pytest.approx(53.5)]
        assert len(found) == 2 + 36


def test_the_running_hour_goes_on_after_a_restart(tmp_path: Path) -> None:
    start = 3600 - EPOCH_S % 3600
    for first in (0, 10):
        store = Store(SMALL, tmp_path / "s.sqlite")
        for i in range(first, first + 10):
            store.add_snapshot(snapshot(start + i, value=float(i)))
        store.commit()
        store.close()
    with StoreReader(tmp_path / "s.sqlite") as reader:
        (_, means), *rest = reader.hours("axis")
    assert not rest
    assert (means["stiffness"].count, means["stiffness"].mean) == (20, pytest.approx(9.5))


def test_a_reader_sees_each_commit_while_the_writer_goes_on(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    filled(store, 0, 1)
    with StoreReader(tmp_path / "s.sqlite") as reader:
        for second in range(1, 5):
            filled(store, second, second + 1)
            assert reader.newest_s() == pytest.approx(EPOCH_S + second + 1)


def test_an_export_is_a_recording_with_flawed_samples_as_nan(tmp_path: Path) -> None:
    store = Store(SMALL, tmp_path / "s.sqlite")
    given = [block(number) for number in range(20)]
    given[3].flaws["theta_out_rad"][10:20] = Flaw.RANGE
    extra = np.arange(100.0)
    given[12] = block(12, values={"theta_out_rad": extra, "torque_out_Nm": extra, "temperature_degC": extra})
    for row in given:
        store.add_block(row)
    store.commit()
    with StoreReader(tmp_path / "s.sqlite") as reader:
        time_s, columns = recording_of(reader, "axis", EPOCH_S + 0.1)
    assert len(time_s) == 1900
    assert np.abs(time_s - EPOCH_S - np.arange(100, 2000) / 1000).max() < 1e-6
    flawed = np.isnan(columns["theta_out_rad"])
    assert np.flatnonzero(flawed).tolist() == list(range(210, 220))
    assert np.array_equal(columns["torque_out_Nm"][:100], given[1].values["torque_out_Nm"])
    assert np.isfinite(columns["temperature_degC"]).sum() == 100


def test_a_clock_that_is_still_being_steered_exports_no_acceleration(tmp_path: Path) -> None:
    """A device samples evenly; the gateway's map of its counter is 1 ms late at first and steered back within 4 s.

    Each block starts where the map says: a twentieth of a millisecond between two blocks reads as 3 rad/s^2."""
    store = Store(SMALL, tmp_path / "s.sqlite")
    taken_s = np.arange(8000) / 1000
    angle = np.sin(2 * np.pi * taken_s)
    for number in range(80):
        part = slice(100 * number, 100 * number + 100)
        row = block(number, values={"theta_out_rad": angle[part]})
        late_s = 1e-3 * np.exp(-number / 10 / 2.0)
        store.add_block(dataclasses.replace(row, start_s=row.start_s + float(late_s)))
    store.add_block(block(85))  # a gap of half a second stays where it was
    store.commit()
    with StoreReader(tmp_path / "s.sqlite") as reader:
        time_s, columns = recording_of(reader, "axis")
    run = slice(0, 8000)
    lie_s = time_s[run] - EPOCH_S - taken_s
    assert np.abs(lie_s).max() < 2e-3
    every = slice(0, 8000, 10)  # stamps since 1970 are steps of 0.2 us: too coarse for differences over 1 ms
    exported = np.gradient(np.gradient(columns["theta_out_rad"][every], time_s[every]), time_s[every])[5:-5]
    assert np.abs(exported + (2 * np.pi) ** 2 * angle[every][5:-5]).max() < 0.2
    assert time_s[8000] - EPOCH_S == pytest.approx(8.5, abs=1e-6)


# the limit


def test_the_file_with_its_journal_never_grows_past_its_limit_and_the_oldest_goes_first(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    store = Store(SMALL, path)
    noise = {str(i): np.random.default_rng(i).normal(0, 1, 5000) for i in range(8)}
    largest = 0
    for number in range(60):
        values = {name: np.roll(row, number) for name, row in noise.items()}
        start_s = EPOCH_S + 5 * number
        flaws = {name: np.zeros(5000, dtype=np.uint8) for name in values}
        store.add_block(Block("axis", number, start_s, 1000.0, values, flaws))
        for second in range(5):
            store.add_snapshot(snapshot(5 * number + second))
        store.add_event(Event("axis", start_s, NE107.OK, "test", f"{number}"))
        store.commit()
        largest = max(largest, file_bytes(path))
    assert 6 * 2**20 < largest <= 8 * 2**20
    with StoreReader(path) as reader:
        kept = [row.sequence for row in reader.blocks("axis")]
        assert kept == list(range(kept[0], 60))
        assert len(kept) >= 3
        assert len(reader.estimates("axis", ["stiffness"])) == 300, "blocks make room, not the few bytes of estimates"
        assert len(reader.events()) == 60
    assert sound(path)


def test_a_smaller_limit_shrinks_the_file_at_the_next_start(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    store = Store(Settings(max_mib=24), path)
    for number in range(40):
        values = {str(i): np.random.default_rng(number + i).normal(0, 1, 10_000) for i in range(8)}
        flaws = {name: np.zeros(10_000, dtype=np.uint8) for name in values}
        store.add_block(Block("axis", number, EPOCH_S + 10 * number, 1000.0, values, flaws))
        store.commit()
    store.close()
    assert file_bytes(path) > 16 * 2**20
    again = Store(SMALL, path)
    assert file_bytes(path) <= 8 * 2**20
    with StoreReader(path) as reader:
        kept = [row.sequence for row in reader.blocks("axis")]
    assert kept == list(range(kept[0], 40))
    filled(again, 1000, 1003)
    assert sound(path)


def test_a_reader_that_holds_the_journal_does_not_make_it_grow(tmp_path: Path) -> None:
    path = tmp_path / "s.sqlite"
    store = Store(SMALL, path)
    filled(store, 0, 1)
    holder = sqlite3.connect(path)
    holder.execute("BEGIN")
    holder.execute("SELECT count(*) FROM chunk").fetchone()
    with pytest.raises(StoreError, match="a reader holds the journal"):
        filled(store, 1, 200)
    assert file_bytes(path) < 2 * 2**20
    holder.close()
    filled(store, 200, 202)
    with StoreReader(path) as reader:
        kept = [row.sequence for row in reader.blocks("axis")]
    assert kept[:10] == list(range(10)), "what was stored before"
    assert kept[-20:] == list(range(2000, 2020)), "what came after"
    assert kept[:-20] == list(range(len(kept) - 20)), "and what waited meanwhile"
    store.close()


def test_without_blocks_only_blocks_are_left_out(tmp_path: Path) -> None:
    store = Store(Settings(max_mib=8, keep_blocks=False), tmp_path / "s.sqlite")
    filled(store, 0, 3)
    with StoreReader(tmp_path / "s.sqlite") as reader:
        assert list(reader.blocks("axis")) == []
        assert len(reader.estimates("axis", ["stiffness"])) == 3
        assert math.isfinite(reader.newest_s())


def test_estimates_are_packed_to_the_last_bit_and_those_of_before_are_read_as_they_are() -> None:
    rows = [Estimate(f"q{i}", 1.0 + i / 7, 0.1 * i, "1", [*Status][i % 4], EPOCH_S) for i in range(40)]
    given = dataclasses.replace(snapshot(7), estimates={row.name: row for row in rows})
    names, packed = names_of(given), pack_estimates(given)
    assert unpack_estimates(names, packed) == dict(given.estimates)
    plain = b"".join(
        struct.pack("<dddB", row.value, row.sd, row.time_s, [*Status].index(row.status))
        for row in given.estimates.values()
    )
    assert unpack_estimates(names, plain) == dict(given.estimates) and len(packed) < len(plain)
    with pytest.raises(DAMAGE):
        unpack_estimates(names, packed[:-3])

"""What tools/vm takes for granted; the machine itself is not in here."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
from field import __main__ as program
from field import power, record
from field.cases import FAULTS
from field.image import GUEST
from field.share import LEAST

ROOT = Path(__file__).parents[1]


def test_the_guests_configuration_is_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in (GUEST / "gateway.toml", ROOT / "config" / "axis.model.toml", ROOT / "edge_daemon/rig/drive.dbc"):
        shutil.copy(file, tmp_path)
    assert main(["check", str(tmp_path / "gateway.toml")]) == 0, capsys.readouterr().err
    assert f"commit_every_s = {power.COMMIT_S}" in (GUEST / "gateway.toml").read_text()


def test_what_is_lost_is_counted_in_gaps_also_at_both_ends() -> None:
    time_s = np.concatenate((np.arange(2.0, 5.0, 0.01), np.arange(7.0, 9.0, 0.01)))
    kept = record.Kept(time_s, wrong=0, damaged_rows=0, events=[])
    assert kept.lost_s(2.0, 8.0) == pytest.approx(2.01)
    assert kept.lost_s(0.0, 10.0) == pytest.approx(2.0 + 2.01 + 1.01)
    assert kept.lost_s(20.0, 21.0) == pytest.approx(1.0)
    assert kept.lost_s(2.5, 4.5) == 0.0


def test_the_short_form_is_part_of_the_full_one_and_names_are_told_apart() -> None:
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    assert 5 < sum(fault.short for fault in FAULTS) < len(FAULTS)


def test_a_starved_guest_says_nothing_but_wrong_data_are_no_ones_hunger() -> None:
    busy = LEAST / 2
    assert program.Line("a", "").verdict == program.Line("a", "", share=busy).verdict == "yes"
    assert program.Line("a", "late").verdict == "no"
    assert program.Line("a", "late", share=busy).verdict == "starved"
    assert program.Line("a", "3 wrong values", share=busy, grave=True).verdict == "no"


def test_the_table_names_every_fault_and_tests_that_are_there() -> None:
    given = {FAULTS[0].name: {"survived": "yes", "lost_s": 1.25, "restart_s": None, "on": "2026-01-01"}}
    rows = program.table(given)[2:]
    assert rows[0].startswith(f"| {FAULTS[0].name} | yes | 1.2 |  | 2026-01-01 | ")
    assert len(rows) == len(FAULTS) + len(program.CUTS)
    assert all("| not tried |" in row for row in rows[1:])
    for held in filter(None, (*(fault.held for fault in FAULTS), power.HELD)):
        file, _, test = held.partition("::")
        assert f"def {test}" in (ROOT / file).read_text(), held

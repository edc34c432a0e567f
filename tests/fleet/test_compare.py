"""Drives that differ from their peers, against fleets in which it is known which do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.cli import main
from edge_daemon.fleet.past import pasts
from tools.fleet_lives import mixed_fleet


def compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[set[str], dict[str, Any]]:
    assert main(["fleet", "compare", str(folder), "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    return {f"{row['site']}/{row['gateway']}/{row['drive']}" for row in found["units"]}, found


@pytest.mark.slow
def test_the_planted_drives_are_named_and_share_one_group(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hits = named = planted = 0
    for seed in range(5):
        truth = set(mixed_fleet(tmp_path / str(seed), seed))
        units, found = compared(tmp_path / str(seed), capsys)
        hits, named, planted = hits + len(units & truth), named + len(units), planted + len(truth)
        group = found["groups"][0]
        assert set(group["drives"]) >= {*truth} & units and "missing effect" in group["what"]
    assert hits >= 0.9 * planted and hits >= 0.9 * named


@pytest.mark.slow
def test_a_fleet_of_equals_names_next_to_nobody(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A twentieth of the fleets may hold one: of five fleets of 280 at most three drives."""
    wrong = 0
    for seed in range(5):
        mixed_fleet(tmp_path / str(seed), 100 + seed, share=0.0)
        wrong += len(compared(tmp_path / str(seed), capsys)[0])
    assert wrong <= 3


def test_a_heavy_load_is_no_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The most heavily loaded drives have the largest model error and friction; none of them is named for it."""
    mixed_fleet(tmp_path, 7, share=0.0)
    by_load = sorted(pasts(tmp_path), key=lambda past: -past.mean("torque_rms"))
    assert by_load[0].mean("coulomb_friction") > 1.2 * by_load[-1].mean("coulomb_friction")
    units, _ = compared(tmp_path, capsys)
    assert not units & {past.drive for past in by_load[:10]}


def test_files_may_be_split_in_any_way(tmp_path: Path) -> None:
    from tools import fleet_lives

    for files in (1, 5):
        rows = [
            {"site": "s", "gateway": "g", "drive": f"d{n % 3}", "topic": "load", "sequence": n, "time_s": 1e9 + n,
             "numbers": {"torque_rms": 1.0 + n / 7, "speed_in": (None, "unknown"), "damping": (9.0, "invalid")}}
            for n in range(30)
        ]  # fmt: skip
        fleet_lives.written(tmp_path / str(files), rows, files)
    one, five = pasts(tmp_path / "1"), pasts(tmp_path / "5")
    assert [past.drive for past in one] == [past.drive for past in five] == ["s/g/d0", "s/g/d1", "s/g/d2"]
    for left, right in zip(one, five, strict=True):
        assert left.torque == right.torque and set(left.means) == {"torque_rms"}
        assert left.mean("torque_rms") == pytest.approx(right.mean("torque_rms"), rel=1e-12)
        assert left.newest("torque_rms") == right.newest("torque_rms") == 1.0 + (27 + int(left.drive[-1])) / 7

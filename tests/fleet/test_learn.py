"""What a fleet's lives teach, against laws that the lives were drawn from."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.cli import main
from tools.fleet_lives import LifeTruth, worn_fleet, written


def learned(folder: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, Any]:
    assert main(["fleet", "learn", str(folder), "--json", "-", *more]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.slow
def test_shape_and_exponent_lie_in_their_intervals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two hundred lives of which 60 % go on, six fleets: of 18 intervals of 90 % at most five may miss (p < 0.01)."""
    held, widths = 0, []
    for seed in range(6):
        truth = LifeTruth(1.2 + 0.4 * seed, 3.0 + seed, 8000.0)
        worn_fleet(tmp_path / str(seed), seed, truth=truth)
        found = learned(tmp_path / str(seed), capsys)
        assert (found["drives"], found["failed"], found["censored"]) == (200, 80, 120)
        pairs = (
            ("weibull_shape", truth.shape),
            ("damage_exponent", truth.exponent),
            ("characteristic_life_h", truth.scale_h),
        )
        for name, value in pairs:
            held += found[name]["from"] <= value <= found[name]["to"]
            assert found[name]["sd"] > 0.0
            assert found[name]["median"] == pytest.approx(value, rel=0.5)
        widths.append(found["damage_exponent"]["to"] - found["damage_exponent"]["from"])
    assert held >= 13
    assert max(widths) < 2.5


def test_lives_that_go_on_are_not_taken_for_failures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same lives with most of them cut off early say the same life, less surely; not a shorter one."""
    worn_fleet(tmp_path / "few", 3, censored=0.1)
    worn_fleet(tmp_path / "many", 3, censored=0.8)
    few, many = (learned(tmp_path / name, capsys)["characteristic_life_h"] for name in ("few", "many"))
    assert many["from"] < few["median"] < many["to"] and many["sd"] > few["sd"]


def test_a_learned_prior_is_taken_by_life(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worn_fleet(tmp_path / "fleet", 1)
    prior = tmp_path / "prior.json"
    found = learned(tmp_path / "fleet", capsys, "--out", str(prior))
    rows = "\n".join(f"{hour},1300,45,110" for hour in range(1, 500))
    (tmp_path / "h.csv").write_text(f"time_h,speed_in_rpm,torque_cubic_mean_Nm,torque_peak_Nm\n{rows}\n")
    command = ["life", str(tmp_path / "h.csv"), "--gear", "CSG-20-100", "--json", "-"]
    told = []
    for more in ([], ["--prior", str(prior)]):
        assert main([*command, *more]) == 0
        told.append(json.loads(capsys.readouterr().out)["rul_h"])
    maker, taught = told
    life_h = 8000.0 * (45.0 / 52.0) ** -6 / 1.3  # of this gear at its load, by the truth; it has run 500 h
    expected = {p: life_h * math.log(1.0 / left) ** 0.5 for p, left in (("p10", 0.9), ("p50", 0.5), ("p90", 0.1))}
    assert taught["p50"] == pytest.approx(expected["p50"], rel=0.35)
    assert abs(math.log(taught["p50"] / expected["p50"])) < 0.5 * abs(math.log(maker["p50"] / expected["p50"]))
    assert taught["p10"] < expected["p50"] < taught["p90"] and found["failed"] == 80


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ([], "no files: expected what `fleet collect` writes"),
        (["--gear", "CSG-20"], "is not in the catalogue"),
        (["--scheduler", "tcp://127.0.0.1:1"], "--scheduler tcp://127.0.0.1:1: nobody answers"),
    ],
)
def test_what_cannot_be_learned_is_said(
    words: list[str],
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("edge_daemon.fleet.engine.CONNECT_S", "1s")
    if "--scheduler" in words:
        worn_fleet(tmp_path, 0, drives=4)
    assert main(["fleet", "learn", str(tmp_path), *words]) == 2
    told = capsys.readouterr().err
    assert complaint in told and told.count("\n") == 1


def test_too_few_failures_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worn_fleet(tmp_path, 0, drives=40, censored=0.9)
    assert main(["fleet", "learn", str(tmp_path)]) == 2
    assert "4 of 40 drives have failed: expected at least 5" in capsys.readouterr().err


def test_without_dask_a_line_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    written(tmp_path, [{"site": "s", "gateway": "g", "drive": "d", "topic": "load", "sequence": 0, "time_s": 1e9,
                        "numbers": {"torque_rms": 1.0}}])  # fmt: skip
    monkeypatch.setitem(sys.modules, "dask", None)
    for part in ("learn", "compare"):
        assert main(["fleet", part, str(tmp_path)]) == 2
        assert capsys.readouterr().err == "edge-daemon: this needs Dask: pip install edge-daemon[fleet]\n"

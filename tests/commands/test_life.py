"""`life` and `learn` as a user meets them: plans, learned priors, flawed files and gears without a past."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main

HEADER = "time_h,speed_in_rpm,torque_cubic_mean_Nm,torque_peak_Nm,stiffness_Nm_per_rad"


def written(path: Path, life_h: float, until: float = 1.0, seed: int = 0, loss: float = 0.2) -> Path:
    """A gear that loses `loss` of its stiffness until it fails at `life_h`; the file ends at a share of it."""
    rng = np.random.default_rng(seed)
    t = np.arange(5.0, until * life_h, 5.0)
    stiffness = 1.6e4 * (1 - loss * (t / life_h) ** 1.5) * (1 + 0.005 * rng.normal(size=t.size))
    rows = np.column_stack((t, 0 * t + 1500, 0 * t + 55, 0 * t + 80, stiffness))
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=HEADER, comments="")
    return path


def asked(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    capsys.readouterr()
    assert main(["life", *map(str, arguments), "--gear", "CSG-20-100", "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert main([*map(str, arguments), "--gear", "CSG-20-100"]) == 2
    return capsys.readouterr().err


def test_more_torque_shortens_the_life(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path / "history.csv", 6000.0, 0.6)
    usual = asked(capsys, file)
    harder = asked(capsys, file, "--load-factor", "1.2")
    assert harder["rul_h"]["p50"] < 0.75 * usual["rul_h"]["p50"]
    assert any("1.2 times the torque" in reason for reason in harder["reasons"])
    assert "--load-factor" in refused(capsys, "life", file, "--load-factor", "-1")


def test_a_gear_without_a_past_has_the_makers_life(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "new.csv"
    file.write_text(HEADER + "\n")
    said = asked(capsys, file)
    assert said["time_h"] == 0.0
    assert any("no history" in reason and "maker" in reason for reason in said["reasons"])
    # L50 of the bearing is 50 000 h; the flexspline competes, so the median lies below
    assert 10_000 < said["rul_h"]["p50"] < 55_000


def test_hours_in_another_unit_are_asked_for_as_hours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "seconds.csv"
    file.write_text(HEADER.replace("time_h", "time_s") + "\n1,1500,40,60,16000\n")
    assert main(["life", str(file), "--gear", "CSG-20-100"]) == 2
    assert "if 'time_s' is the time, it wants to be in hours and called time_h" in capsys.readouterr().err


def test_one_row_is_too_little_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "day_one.csv"
    file.write_text(HEADER + "\n1,1500,40,60,16000\n")
    said = asked(capsys, file)
    assert said["time_h"] == 1.0
    assert any("only 1 h of history" in reason and "maker" in reason for reason in said["reasons"])
    # rated life 50 000 h at 52 N m and 2000 rpm; cubic law: (52/40)^3 * 2000/1500 = 2.9 times that
    assert 60_000 < said["rul_h"]["p50"] < 160_000


def test_a_history_that_begins_late_and_lacks_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Irregular rows from hour 1000 on, half of the stiffness missing, no torque: an answer with its assumptions."""
    rng = np.random.default_rng(8)
    t = 1000.0 + np.sort(rng.uniform(0.0, 2000.0, 900))
    stiffness = np.where(rng.uniform(size=900) < 0.5, np.nan, 1.6e4 * (1.0 - 0.05 * (t / 3000.0) ** 2))
    rows = np.column_stack((t, np.full(900, 1500.0), stiffness))
    file = tmp_path / "history.csv"
    np.savetxt(file, rows, fmt="%.9g", delimiter=",", header="time_h,speed_in_rpm,stiffness_Nm_per_rad", comments="")
    said = asked(capsys, file)
    assert said["state"] == "function_check"
    assert any("torque unknown for 100%" in reason for reason in said["reasons"])
    assert any("no rows before" in reason for reason in said["reasons"])
    assert 0.0 < said["rul_h"]["p10"] < said["rul_h"]["p50"] < said["rul_h"]["p90"]


def test_a_clock_that_ran_backward_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path / "history.csv", 6000.0, 0.3)
    lines = file.read_text().splitlines()
    lines[50], lines[60] = lines[60], lines[50]
    file.write_text("\n".join(lines) + "\n")
    said = asked(capsys, file)
    assert any("clock" in reason for reason in said["reasons"])
    assert said["state"] == "function_check"


def test_what_cannot_be_a_history_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "history.csv"
    file.write_text(HEADER + "\n1,1500,-55,80,1.6e4\n2,1500,55,80,1.6e4\n")
    said = refused(capsys, "life", file)
    assert "history.csv" in said and "torque_cubic_mean_Nm" in said and "-55" in said
    file.write_text(HEADER + "\n1,1500,55,80,1.6e4\n900000,1500,55,80,1.6e4\n")
    assert "jumps" in refused(capsys, "life", file)


@pytest.mark.slow
def test_learned_gears_make_the_forecast_sharper(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    failed = [written(tmp_path / f"{i}.csv", 3000.0 + 500.0 * i, seed=i) for i in range(6)]
    out = tmp_path / "prior.json"
    assert "expected at least 5" in refused(capsys, "learn", *failed[:2], "--out", out)
    assert main(["learn", *map(str, failed), "--gear", "CSG-20-100", "--out", str(out)]) == 0
    assert "stiffness log_size" in capsys.readouterr().out
    file = written(tmp_path / "history.csv", 4200.0, 0.5, seed=9)
    fresh, taught = asked(capsys, file)["rul_h"], asked(capsys, file, "--prior", out)["rul_h"]
    assert taught["p90"] - taught["p10"] < 0.7 * (fresh["p90"] - fresh["p10"])
    assert taught["p50"] == pytest.approx(2100.0, rel=0.25)
    out.write_text("{}")
    assert "prior.json" in refused(capsys, "life", file, "--prior", out)


def test_a_misspelt_column_is_told_with_the_one_that_was_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path / "history.csv", 6000.0, 0.6)
    file.write_text(
        file.read_text().replace("torque_cubic_mean_Nm", "torque_cubic_Nm").replace("torque_peak_Nm", "oil")
    )
    said = asked(capsys, file)["reasons"]
    assert "column 'torque_cubic_Nm' is not used: did you mean 'torque_cubic_mean_Nm'?" in said
    assert not any("'oil'" in reason for reason in said)

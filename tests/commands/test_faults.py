"""`faults` as a user meets it: a history with a fault, one without, recordings with a singing bearing, and mistakes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main

GEAR = ("--gear", "CSG-20-100")


def written(path: Path, moved: dict[str, float], hours: int = 900) -> Path:
    """Hours of a working week; from two thirds on a fault grows to the logarithms in `moved`."""
    rng = np.random.default_rng(7)
    time_h = np.arange(1.0, hours + 1)
    warm = 30 + 5 * np.sin(time_h / 24 * 2 * math.pi) + rng.normal(size=hours)
    grown = np.clip((time_h / hours - 0.6) / 0.2, 0.0, 1.0)
    columns = {"time_h": time_h, "temperature_degC": warm}
    columns["torque_cubic_mean_Nm"] = 30 + 6 * (time_h % 24 > 8) + rng.normal(size=hours)
    columns["speed_in_rpm"] = 1500 + 30 * rng.normal(size=hours)
    levels = {"stiffness_Nm_per_rad": (1.6e4, 0.005), "coulomb_friction": (1.5, 0.05), "kinematic_error": (3e-4, 0.03)}
    levels |= {f"noise_a{beta}": (1e-4, 0.1) for beta in range(5)}
    for name, (level, sd) in levels.items():
        told = moved.get(name, 0.0) * grown + sd * rng.normal(size=hours) + 5e-4 * (warm - 30)
        columns[name] = level * np.exp(told)
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    return path


def asked(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    capsys.readouterr()
    assert main(["faults", *map(str, arguments), *GEAR, "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert main(["faults", *map(str, arguments), *GEAR]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line


def test_a_fault_is_named_and_a_well_gear_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    worn = {"noise_a0": 0.7, "noise_a1": 0.5, "noise_a2": 0.15, "coulomb_friction": 0.05}
    told = asked(capsys, written(tmp_path / "worn.csv", worn))
    assert told["named"] == "bearing wear"
    assert sum(told["kinds"].values()) == pytest.approx(1.0)
    assert asked(capsys, written(tmp_path / "well.csv", {}))["named"] == "none"
    strange = {"noise_a4": -1.2, "coulomb_friction": -0.6, "kinematic_error": 0.5}
    assert asked(capsys, written(tmp_path / "strange.csv", strange))["named"] == "unknown"


def test_recordings_tell_which_ring(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A blow each time a ball passes the inner ring's pit: 0.55 of 23 balls a turn against the outer."""
    time_s = np.arange(0.0, 12.0, 1 / 4000.0)
    turn = 12.0 * time_s
    for name, strength in (("well", 0.0), ("ill", 2.5)):
        rng = np.random.default_rng(2)
        struck = np.diff(np.floor(0.55 * 23 * 1.01 * turn), prepend=0.0) > 0
        ring = np.exp(-np.arange(40) / 8.0) * np.sin(2 * np.pi * 1400 / 4000 * np.arange(40))
        sound = strength * np.convolve(struck, ring)[: time_s.size] + rng.normal(size=time_s.size)
        rows = np.column_stack((time_s, 2 * np.pi * turn, sound))
        np.savetxt(
            tmp_path / f"{name}.csv", rows, fmt="%.7g", delimiter=",", header="time_s,theta_in_rad,sound", comments=""
        )
    worn = {"noise_a0": 0.7, "noise_a1": 0.5, "noise_a2": 0.15, "coulomb_friction": 0.05}
    history = written(tmp_path / "history.csv", worn)
    lines = ("--recording", tmp_path / "ill.csv", "--reference", tmp_path / "well.csv", "--bearing", "23,0.1")
    assert asked(capsys, history, *lines)["finest"] == "bearing inner ring"
    assert asked(capsys, history)["finest"] == "bearing wear"


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = written(tmp_path / "history.csv", {}, 200)
    assert "--bearing" in refused(capsys, history, "--bearing", "many")
    assert "--bearing" in refused(capsys, history, "--bearing", "23,2")
    assert "--reference" in refused(capsys, history, "--recording", history)
    empty = tmp_path / "empty.csv"
    empty.write_text("time_h,stiffness_Nm_per_rad\n")
    assert "expected a history" in refused(capsys, empty)
    bare = tmp_path / "bare.csv"
    bare.write_text("time_h,speed_in_rpm\n" + "".join(f"{hour},1500\n" for hour in range(1, 100)))
    assert "no condition" in refused(capsys, bare)

"""`compensate` as a person types it: tables that agree with a C compiler, parts that are off, refusals."""

from __future__ import annotations

import csv
import ctypes
import json
import math
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main

MODEL = """[joint]
balance = "torsion"
ratio = 100.0
output_inertia_kg_m2 = 1.2
[[effect]]
name = "linear_stiffness"
[effect.parameters.stiffness]
value = 20000.0
sd = 50.0
unit = "N m/rad"
identified = true
[[effect]]
name = "kinematic_error"
"""
WAVES = {"sine_1": 0.0, "cosine_1": 0.0, "sine_2": 5e-5, "cosine_2": 0.0, "sine_4": 0.0, "cosine_4": 1e-5}


@pytest.fixture
def model(tmp_path: Path) -> Path:
    rows = [
        f'[effect.parameters.{name}]\nvalue = {value}\nsd = 1e-7\nunit = "rad"\nidentified = true'
        for name, value in WAVES.items()
    ]
    path = tmp_path / "gear.toml"
    path.write_text(MODEL + "\n".join(rows) + "\n")
    return path


def truth(theta: float, torque: float) -> float:
    """R (torque / K - e), by hand."""
    return 100.0 * (torque / 20000.0 - 5e-5 * math.sin(2 * theta) - 1e-5 * math.cos(4 * theta))


def test_the_table_is_the_model_turned_about(model: Path, tmp_path: Path) -> None:
    out = tmp_path / "offsets.csv"
    assert main(["compensate", "--model", str(model), "--csv", str(out), "--json", str(tmp_path / "j.json")]) == 0
    rows = list(csv.DictReader(out.open()))
    turn = [row for row in rows if row["table"] == "kinematic"]
    twist = [row for row in rows if row["table"] == "twist"]
    for row in turn:
        assert float(row["offset_in_rad"]) == pytest.approx(truth(float(row["theta_in_rad"]), 0.0), abs=1e-7)
    for row in twist:
        assert float(row["offset_in_rad"]) == pytest.approx(100 * float(row["torque_out_Nm"]) / 2e4, abs=2e-3)
    document = json.loads((tmp_path / "j.json").read_text())
    assert document["shaper"]["frequency_hz"] == pytest.approx(math.sqrt(20000 / 1.2) / 2 / math.pi)
    assert sum(document["shaper"]["shares"]) == pytest.approx(1.0) and not document["confirmed"]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
def test_the_header_says_the_same_to_a_compiler(model: Path, tmp_path: Path) -> None:
    header, source, library = tmp_path / "o.h", tmp_path / "o.c", tmp_path / "o.so"
    assert main(["compensate", "--model", str(model), "--header", str(header)]) == 0
    source.write_text('#include "o.h"\nfloat at(float a, float t) { return ed_offset_rad(a, t); }\n')
    words = [
        "cc",
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-shared",
        "-fPIC",
        str(source),
        "-o",
        str(library),
        "-lm",
    ]
    subprocess.run(words, check=True)
    at = ctypes.CDLL(str(library)).at
    at.restype, at.argtypes = ctypes.c_float, [ctypes.c_float, ctypes.c_float]
    for theta, torque in np.random.default_rng(3).uniform((-20, -90), (20, 90), (50, 2)).tolist():
        assert at(theta, torque) == pytest.approx(truth(theta, torque), abs=2e-4)


def test_bounds_hold_and_a_recording_that_says_otherwise_switches_off(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = np.arange(0, 10, 0.005)
    theta_in = 30 * (1 - np.cos(time))
    rng = np.random.default_rng(2)
    theta_out = theta_in / 100 - 5e-5 * np.sin(2 * theta_in) + 1e-7 * rng.normal(size=len(time))  # the other sign
    recording = tmp_path / "rec.csv"
    rows = np.column_stack([time, theta_in, theta_out])
    np.savetxt(recording, rows, delimiter=",", header="time_s,theta_in_rad,theta_out_rad", comments="", fmt="%.12g")
    words = ["compensate", "--model", str(model), "--recording", str(recording), "--limit", "0.1", "--json", "-"]
    assert main(words) == 0
    parts = json.loads(capsys.readouterr().out)["parts"]
    assert not parts["kinematic"]["on"] and "expected 1" in parts["kinematic"]["why"]
    assert parts["twist"]["largest_rad"] <= 0.1


def test_what_cannot_be_is_one_line(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = tmp_path / "drive.toml"
    drive.write_text('[joint]\nbalance = "drive"\nratio = 100.0\n[[effect]]\nname = "inertia"\n')
    for words, part in (
        (["--model", str(drive)], "torsion"),
        (["--model", str(model), "--limit", "-1"], "--limit"),
        (["--model", str(tmp_path / "none.toml")], "none.toml"),
    ):
        assert main(["compensate", *words]) == 2
        line = capsys.readouterr().err
        assert part in line and line.count("\n") == 1


def planned(folder: Path, uneven: bool = False) -> Path:
    """Three seconds at 250 Hz and 0.4 rad/s of the output, under 20 N m."""
    path = folder / "planned.csv"
    rows = [f"{0.004 * k + (0.002 if uneven and k == 70 else 0)},{0.0016 * k},20" for k in range(751)]
    path.write_text("time_s,theta_out_rad,torque_model_Nm\n" + "\n".join(rows) + "\n")
    return path


def test_a_planned_motion_becomes_the_words_a_drive_takes(model: Path, tmp_path: Path) -> None:
    words = ["compensate", "--model", str(model), "--trajectory", str(planned(tmp_path)), "--stream"]
    out = tmp_path / "stream.csv"
    assert main([*words, str(out), "--counts-per-turn", "65536", "--rated-torque", "0.5"]) == 0
    rows = list(csv.DictReader(out.open()))
    told = ("position_offset_counts", "velocity_offset_counts_per_s", "torque_offset_mille")
    assert len(rows) == 751
    for row in rows:
        assert struct.unpack("<iih", bytes.fromhex(row["pdo_hex"])) == tuple(int(row[name]) for name in told)
    for k in range(130, 620, 7):  # faded in, and not yet out
        theta = 100.0 * (0.0016 * k + 20.0 / 20000.0)
        theta += truth(theta, 0.0)
        assert int(rows[k]["position_offset_counts"]) == pytest.approx(truth(theta, 20.0) * 65536 / math.tau, abs=1.5)
        assert int(rows[k]["torque_offset_mille"]) == 400  # 20 N m / 100 of 0.5 N m
    assert int(rows[0]["position_offset_counts"]) < 3 and int(rows[-1]["position_offset_counts"]) < 3


def test_a_planned_motion_that_is_no_motion_is_refused(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["compensate", "--model", str(model), "--trajectory"]
    out = ["--stream", str(tmp_path / "s.csv")]
    assert main([*words, str(planned(tmp_path, uneven=True)), *out]) == 2
    assert "time_s: expected the drive's cycle, evenly" in capsys.readouterr().err
    assert main([*words, str(planned(tmp_path))]) == 2
    assert "--trajectory and --stream: one needs the other" in capsys.readouterr().err
    assert main([*words, str(planned(tmp_path)), *out, "--rated-torque", "0"]) == 2
    assert "--rated-torque" in capsys.readouterr().err

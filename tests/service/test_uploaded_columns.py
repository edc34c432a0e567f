"""Columns of an uploaded recording: guessed, asked about, and read as a person says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import read_recording
from edge_daemon.service.uploaded_columns import keep_columns, preview


def written(folder: Path, text: str) -> Path:
    path = folder / "robot.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "channel", "unit"),
    [
        ("time_ms", "time_s", "ms"),
        ("t", "time_s", "s"),
        ("motor_position_deg", "theta_in_rad", "deg"),
        ("joint_angle_rad", "theta_out_rad", "rad"),
        ("theta_out_rad", "theta_out_rad", "rad"),
        ("current_mA", "current_in_A", "mA"),
        ("tau", "torque_in_Nm", "N m"),
        ("flag", "", ""),
    ],
)
def test_what_a_column_is_called_tells_what_it_is(tmp_path: Path, name: str, channel: str, unit: str) -> None:
    (found,) = preview(written(tmp_path, f"{name}\n1.5\n2.5\n"))["columns"]
    assert (found["channel"], found["unit"], found["values"]) == (channel, unit, ["1.5", "2.5"])


def test_a_file_without_header_is_read_as_a_person_says(tmp_path: Path) -> None:
    """Milliseconds, degrees, a motor that counts the other way and a column that nobody wants."""
    path = written(tmp_path, "".join(f"{i};{90 * i};7;{-9 * i}\n" for i in range(5)))
    found = preview(path)
    assert [row["name"] for row in found["columns"]] == ["column_1", "column_2", "column_3", "column_4"]
    assert not found["ready"]
    rows = [("column_1", "time_s", "ms", False), ("column_2", "theta_in_rad", "deg", True),
            ("column_3", "", "", False), ("column_4", "theta_out_rad", "arcmin", False)]  # fmt: skip
    keep_columns(path, [dict(zip(("name", "channel", "unit", "reverse"), row, strict=True)) for row in rows])
    recording = read_recording(path)
    np.testing.assert_allclose(recording.time_s, 1e-3 * np.arange(5))
    np.testing.assert_allclose(recording.columns["theta_in_rad"], -math.pi / 2 * np.arange(5))
    np.testing.assert_allclose(recording.columns["theta_out_rad"], -9 * math.pi / 10_800 * np.arange(5))
    assert preview(path)["ready"]


LOGGER = "Logger: TestLab 5.2\r\nOperator: N. N.\r\n\r\nTime;Joint Angle;Motor Current\r\n[ms];[°];[A]\r\n"


@pytest.mark.parametrize("letters", ["utf-8", "utf-16", "cp1252"])
def test_what_a_logger_writes_above_the_numbers_is_no_column(tmp_path: Path, letters: str) -> None:
    """A preamble, a row of units, Windows letters: the page shows the columns that the comparison reads."""
    path = tmp_path / "robot.csv"
    path.write_bytes((LOGGER + "".join(f"{i};{90 * i},5;0,25\r\n" for i in range(5))).encode(letters))
    found = preview(path)["columns"]
    assert [(row["name"], row["values"][:2]) for row in found] == [
        ("Time", ["0", "1"]), ("Joint Angle", ["0,5", "90,5"]), ("Motor Current", ["0,25", "0,25"])]  # fmt: skip
    keep_columns(path, [{"name": "Time", "channel": "time_s", "unit": "ms"},
                        {"name": "Joint Angle", "channel": "theta_out_rad", "unit": "deg"},
                        {"name": "Motor Current", "channel": "current_in_A", "unit": "A"}])  # fmt: skip
    np.testing.assert_allclose(read_recording(path).columns["theta_out_rad"][:2], np.radians([0.5, 90.5]))


def test_names_in_a_comment_are_names(tmp_path: Path) -> None:
    path = tmp_path / "robot.csv"
    np.savetxt(path, np.zeros((4, 2)), delimiter=",", header="time_ms,joint_angle_deg")
    assert [row["name"] for row in preview(path)["columns"]] == ["time_ms", "joint_angle_deg"]


def test_temperatures_keep_their_zero(tmp_path: Path) -> None:
    path = written(tmp_path, "time_s,T\n0,293.15\n1,294.15\n")
    keep_columns(path, [{"name": "time_s", "channel": "time_s", "unit": "s"},
                        {"name": "T", "channel": "temperature_degC", "unit": "K"}])  # fmt: skip
    np.testing.assert_allclose(read_recording(path).columns["temperature_degC"], [20.0, 21.0])


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([], "time_s: chosen for no column"),
        ([("a", "time_s", "s"), ("b", "time_s", "s")], "time_s: chosen for two columns"),
        ([("c", "time_s", "s")], "column 'c': expected one of a, b"),
        ([("a", "time_s", "rad")], "time_s: unit 'rad': expected one of s, ms, us, min"),
        ([("a", "colour", "s")], "channel 'colour': expected one of time_s, theta_in_rad"),
        ([("a*__import__('os')", "time_s", "s")], "expected one of a, b"),
    ],
)
def test_an_answer_that_makes_no_sense_is_refused(tmp_path: Path, rows: list[tuple[str, str, str]], words: str) -> None:
    path = written(tmp_path, "a,b\n1,2\n")
    with pytest.raises(BadInput, match=words.replace("(", r"\(")):
        keep_columns(path, [dict(zip(("name", "channel", "unit"), row, strict=True)) for row in rows])
    assert list(tmp_path.iterdir()) == [path]


def test_a_recording_with_the_usual_names_needs_no_question(tmp_path: Path) -> None:
    assert preview(written(tmp_path, "time_s,theta_in_rad,theta_out_rad\n0,1,2\n"))["ready"]
    with pytest.raises(BadInput, match="empty"):
        preview(written(tmp_path, "# nothing\n"))

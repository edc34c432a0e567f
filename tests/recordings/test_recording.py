"""Recordings: what is read equals what was written, what is broken is repaired and counted or refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.recordings.column_map import ColumnMap, as_mapped, beside
from edge_daemon.recordings.csv_file import RecordingError
from edge_daemon.recordings.recording import read_recording, write_recording

SEED = 20_240_611


@pytest.mark.parametrize("name", ["r.csv", "r.parquet"])
def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(SEED)
    time_s = 1.7e9 + np.arange(1000) / 1000
    columns = {"theta_in_rad": rng.normal(size=1000) * 1e3, "torque_out_Nm": rng.normal(size=1000) * 1e-7}
    columns["torque_out_Nm"][5] = np.nan
    write_recording(tmp_path / name, time_s, columns)
    recording = read_recording(tmp_path / name)
    np.testing.assert_array_equal(recording.time_s, time_s)
    assert list(recording.columns) == list(columns)
    for column, values in columns.items():
        np.testing.assert_array_equal(recording.columns[column], values)
    assert recording.notes.nan == {"torque_out_Nm": 1}
    assert recording.notes.gaps == recording.notes.duplicates == recording.notes.reordered == 0
    assert recording.notes.interval_s == pytest.approx(1e-3, rel=1e-3)


def _read(tmp_path: Path, text: str | bytes) -> object:
    file = tmp_path / "bad.csv"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_recording(file)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty"),
        ("\n\n", "empty"),
        ("# only a comment\n", "empty"),
        ("time_s,a\n", "no rows"),
        ("time_s,a\n0,1\n", "only 1 row"),
        ("time_s,a\n0,1\n0,2\n0,3\n", "only 1 row"),
        ("time_s,a\nnan,1\n,2\n", "only 0 row"),
        ("t,a\n0,1\n1,2\n", "no column time_s"),
        ("time_s,a,a\n0,1,1\n1,2,2\n", "'a' appears twice"),
        ("time_s,theta_in_rad\n0,1\n1,abc\n2,3\n", "column theta_in_rad: 'abc' is no number"),
        ("0,1\n1,2\n", "line 1 holds numbers: name the columns with --columns"),
        (b"\x7fELF\x00\xff\xfe\x00\n\x00", "not a text file"),
        (b"PAR1 and nothing more", "Parquet"),
    ],
)
def test_what_cannot_be_repaired_is_refused_in_one_line(tmp_path: Path, text: str | bytes, expected: str) -> None:
    with pytest.raises(RecordingError, match=expected) as caught:
        _read(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "bad.csv" in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot read: No such file"):
        read_recording(tmp_path / "none.csv")


def test_text_columns_of_parquet_are_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet

    pyarrow.parquet.write_table(pa.table({"time_s": [0.0, 1.0], "a": ["x", "y"]}), tmp_path / "t.parquet")
    with pytest.raises(RecordingError, match="column a: holds string"):
        read_recording(tmp_path / "t.parquet")


def test_repairs_are_counted(tmp_path: Path) -> None:
    text = "\ufeff# logger 7\ntime_s,a,b\n"
    text += "0.0,1,\n0.1,2,inf\n0.3,4,9\n0.2,3,9\n0.2,8,9\n0.4,5\n0.5,6,nan\nnan,0,0\n1.5,7,9\n"
    (tmp_path / "r.csv").write_text(text)
    recording = read_recording(tmp_path / "r.csv")
    np.testing.assert_array_equal(recording.time_s, [0.0, 0.1, 0.2, 0.3, 0.5, 1.5])
    np.testing.assert_array_equal(recording.columns["a"], [1, 2, 3, 4, 6, 7])
    np.testing.assert_array_equal(recording.columns["b"], [np.nan, np.nan, 9, 9, np.nan, 9])
    notes = recording.notes
    assert (notes.rows, notes.broken_rows, notes.untimed_rows) == (8, 1, 1)
    assert (notes.duplicates, notes.reordered) == (1, 2)
    assert notes.nan == {"b": 3}
    assert (notes.gaps, notes.longest_gap_s) == (2, 1.0)
    assert len(list(notes.lines())) >= 6


def test_rows_of_two_sensors_at_one_time_are_merged(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("time_s,a,b\n0,1,\n0,,5\n1,2,\n1,,6\n")
    recording = read_recording(tmp_path / "r.csv")
    np.testing.assert_array_equal(recording.columns["a"], [1, 2])
    np.testing.assert_array_equal(recording.columns["b"], [5, 6])
    assert recording.notes.duplicates == 2


def test_semicolons_with_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text('"time_s";"a"\r\n0,5;1,25\r\n1,5;-2e-3\r\n')
    recording = read_recording(tmp_path / "r.csv")
    np.testing.assert_array_equal(recording.time_s, [0.5, 1.5])
    np.testing.assert_array_equal(recording.columns["a"], [1.25, -0.002])


@pytest.mark.parametrize("text", ["time_s  a\n0.0 1.5\n 0.1   2.5 \n", "# by hand\ntime_s a\n0.0 1.5\n0.1 2.5\n"])
def test_cells_may_stand_apart_by_spaces(tmp_path: Path, text: str) -> None:
    recording = _read(tmp_path, text)
    assert recording.time_s.tolist() == [0.0, 0.1] and recording.columns["a"].tolist() == [1.5, 2.5]


@pytest.mark.parametrize("seen", ["head", "row"])
def test_a_cell_between_single_spaces_may_be_empty(tmp_path: Path, seen: str) -> None:
    """A current that begins late: the rows without it had a cell too few, or no header was found above them."""
    rows = ["0.0 1.5 2", "0.1 2.5 3", "0.2  4", "0.3 4.5 "]
    rows = [rows[2].replace("0.2", "-0.1"), *rows] if seen == "head" else rows
    recording = _read(tmp_path, "\n".join(["time_s a b", *rows, ""]))
    np.testing.assert_array_equal(recording.columns["a"][-4:], [1.5, 2.5, np.nan, 4.5])
    np.testing.assert_array_equal(recording.columns["b"][-4:], [2, 3, 4, np.nan])
    assert recording.notes.broken_rows == 0


def test_shuffled_and_reversed_rows_are_sorted_but_two_runs_are_not_mixed(tmp_path: Path) -> None:
    time_s = np.arange(500) / 100
    value = np.sin(time_s)
    for order in (np.random.default_rng(SEED).permutation(500), np.arange(500)[::-1]):
        write_recording(tmp_path / "r.csv", time_s[order], {"a": value[order]})
        recording = read_recording(tmp_path / "r.csv")
        np.testing.assert_array_equal(recording.columns["a"], value)
    write_recording(
        tmp_path / "two.csv", np.concatenate((time_s, time_s + 1e-3)), {"a": np.concatenate((value, -value))}
    )
    with pytest.raises(RecordingError, match=r"runs back from 4\.99 to 0\.001 at row 501"):
        read_recording(tmp_path / "two.csv")


def test_a_stretch_that_is_written_twice_is_merged_but_not_one_that_says_something_else(tmp_path: Path) -> None:
    time_s = np.arange(500) / 100
    value = np.sin(time_s)
    again = np.concatenate((time_s, time_s[100:300]))
    write_recording(tmp_path / "r.csv", again, {"a": np.concatenate((value, value[100:300]))})
    recording = read_recording(tmp_path / "r.csv")
    np.testing.assert_array_equal(recording.columns["a"], value)
    assert recording.notes.duplicates == 200
    write_recording(tmp_path / "two.csv", again, {"a": np.concatenate((value, -value[100:300]))})
    with pytest.raises(RecordingError, match=r"runs back from 4\.99 to 1 at row 501"):
        read_recording(tmp_path / "two.csv")


def test_lines_may_end_with_a_return_alone(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(b"time_s,a\r0,1\r1,2\r")
    np.testing.assert_array_equal(read_recording(tmp_path / "r.csv").columns["a"], [1.0, 2.0])


def test_irregular_sampling_is_measured(tmp_path: Path) -> None:
    rng = np.random.default_rng(SEED)
    time_s = np.arange(2000) / 100 + rng.uniform(-2e-3, 2e-3, 2000)
    write_recording(tmp_path / "r.parquet", time_s, {"a": time_s})
    notes = read_recording(tmp_path / "r.parquet").notes
    # the difference of two independent uniforms of half width h has sd h * sqrt(2/3)
    assert notes.irregularity == pytest.approx(0.2 * np.sqrt(2 / 3), rel=0.05)
    assert notes.gaps == 0


def test_columns_of_unequal_length_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="expected 3 rows"):
        write_recording(tmp_path / "r.csv", np.arange(3.0), {"a": np.arange(2.0)})


def test_the_time_may_have_another_name(tmp_path: Path) -> None:
    (tmp_path / "life.csv").write_text("time_h,torque_peak_Nm\n0,1\n1,\n3,2\n")
    recording = read_recording(tmp_path / "life.csv", time="time_h")
    np.testing.assert_array_equal(recording.time_s, [0, 1, 3])
    assert list(recording.columns) == ["torque_peak_Nm"]
    with pytest.raises(RecordingError, match="no column time_s"):
        read_recording(tmp_path / "life.csv")


def test_rows_that_are_no_text_are_left_out(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "torn.csv").write_bytes(b"time_s,a\n0,1\n1,2\n\xff\xfe\x80\n2,3\n\x00\x00\x00")
    recording = read_recording(tmp_path / "torn.csv")
    np.testing.assert_array_equal(recording.columns["a"], [1, 2, 3])
    assert recording.notes.broken_rows == 2
    assert capfd.readouterr().err == ""


def test_a_damaged_parquet_file_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "r.parquet"
    write_recording(file, np.arange(100.0), {"a": np.arange(100.0)})
    whole = file.read_bytes()
    rng = np.random.default_rng(SEED)
    for _ in range(50):
        damaged = bytearray(whole)
        for at in rng.integers(4, len(whole), 5):
            damaged[at] = int(rng.integers(256))
        file.write_bytes(damaged)
        try:
            recording = read_recording(file)
        except RecordingError as error:
            assert "\n" not in str(error)
        else:
            assert np.all(np.diff(recording.time_s) > 0)


def test_a_single_turn_angle_is_joined_and_counted(tmp_path: Path) -> None:
    t = np.arange(4000) / 1000.0
    motor = 40.0 * np.sin(2 * np.pi * 0.7 * t) + 3.0
    motor[100:103] = np.nan
    for shift in (0.0, np.pi):
        wrapped = np.mod(motor + shift, 2 * np.pi) - shift
        out = 0.01 * motor
        file = tmp_path / "single.parquet"
        write_recording(file, t, {"theta_in_rad": wrapped, "theta_out_rad": out})
        found = read_recording(file)
        known = np.isfinite(motor)
        assert np.ptp((found.columns["theta_in_rad"] - motor)[known]) < 1e-9
        assert found.notes.turns["theta_in_rad"] == np.count_nonzero(np.abs(np.diff(wrapped[known])) > 5)
        assert np.array_equal(found.columns["theta_out_rad"], out, equal_nan=True)
        assert any("single-turn" in line for line in found.notes.lines())


def test_an_angle_whose_jumps_leave_doubt_stays_as_it_is(tmp_path: Path) -> None:
    t = np.arange(1000) / 1000.0
    fast = np.mod(2500.0 * t, 2 * np.pi)
    write_recording(tmp_path / "fast.parquet", t, {"theta_in_rad": fast})
    found = read_recording(tmp_path / "fast.parquet")
    assert np.array_equal(found.columns["theta_in_rad"], fast) and not found.notes.turns


@pytest.mark.parametrize(
    "data",
    [
        b"time_s,a,mode\n0,1,RUN\n1,2,RUN\n2,3,STOP\n",
        b"time_s,a,mode\n0,1,\n1,2,\n2,3,STOP\n",
        b"time_s,a\n[s],[Nm]\n0,1\n1,2\n2,3\n",
        b"Stand 3, run 7\nOperator: K\n\ntime_s,a\n0,1\n1,2\n2,3\n",
        b"time_s,a\n0,1\ntime_s,a\n1,2\n2,3\n",
        b'time_s,a\n"0,0","1,0"\n"1,0","2,0"\n"2,0","3,0"\n',
        b"time_s,a,b\n0,1,-\n1,2,#NV\n2,3,---\n",
        "time_s;a;Winkel [\u00b0]\n0;1;5\n1;2;5\n2;3;5\n".encode("cp1252"),
        "time_s\ta\n0\t1\n1\t2\n2\t3\n".encode("utf-16"),
        b"time_s,a\n2026-11-24T23:59:59.5Z,1\n2026-11-25T00:00:00.5Z,2\n2026-11-25T00:00:01.500Z,3\n",
        b"# time_s a\n0.0e0 1\n1.0e0 2\n2.0e0 3\n",
        b"time_s;a;\n0;1;\n1;2;\n2;3;\n",
        b"Device: X-Log 7\nSerial;00412\nRate;1 Hz\ntime_s;a\n0;1\n1;2\n2;3\n",
        b"time_s,a\n10:11:12,1\n10:11:13,2\n10:11:14,3\n",
    ],
    ids=["text", "text later", "units", "preamble", "joined logs", "quoted commas", "dashes", "Windows", "UTF-16",
         "ISO stamps", "NumPy", "last mark", "table above", "time of day"],
)  # fmt: skip
def test_logs_are_read_as_loggers_write_them(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    read = read_recording(path)
    np.testing.assert_allclose(read.time_s, (0.0, 1.0, 2.0), atol=1e-9)
    np.testing.assert_allclose(read.columns["a"], (1.0, 2.0, 3.0))
    assert "mode" not in read.columns
    assert bool(read.notes.text) == (b"STOP" in data)


def test_what_a_map_uses_is_no_further_channel(tmp_path: Path) -> None:
    """A current under its own name explained the torque that was made of it, at a probability of 1."""
    path = tmp_path / "log.csv"
    path.write_text("row_no,i,q,torque_out_Nm,note\n0,1,5,7,a\n1,2,6,8,b\n")
    formulas = {
        "time_s": "row/500",
        "torque_in_Nm": "i*0.1",
        "theta_out_rad": "q*deg",
        "torque_model_Nm": "torque_out_Nm",
    }
    read = read_recording(path, columns=ColumnMap((), formulas))
    assert set(read.columns) == {"row_no", "torque_in_Nm", "theta_out_rad", "torque_out_Nm", "torque_model_Nm"}
    np.testing.assert_allclose(read.time_s, (0.0, 0.002))
    said = as_mapped("degrees: --map theta_out_rad=theta_out_rad*deg", {"theta_out_rad": "q", "torque_in_Nm": "i*0.1"})
    assert said == "degrees: --map 'theta_out_rad=q*deg'"
    assert as_mapped("--map torque_in_Nm=-torque_in_Nm", formulas) == "--map 'torque_in_Nm=-(i*0.1)'"
    assert as_mapped("--map time_s=row/RATE_HZ", {}) == "--map time_s=row/RATE_HZ"


def test_a_clock_that_is_coarser_than_the_sampling_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a\n" + "".join(f"{i // 4},{i}\n" for i in range(40)))
    assert any("coarser" in line and "--map time_s=row/RATE_HZ" in line for line in read_recording(path).notes.lines())


def test_what_is_kept_beside_a_recording_and_cannot_be_read_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hints are written by it: that was asked for again where it was what is wrong."""
    path, model = tmp_path / "log.csv", tmp_path / "m.toml"
    path.write_text("time_s,a\n0,1\n1,2\n")
    model.write_text('[joint]\nbalance = "drive"\nratio = 100.0\n[[effect]]\nname = "inertia"\n')
    beside(path).write_text("x = [\n")
    assert main(["compare", str(path), "--model", str(model)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "log.csv.columns.toml" in said


def test_a_header_of_a_thousand_long_names_is_read_whole(tmp_path: Path) -> None:
    names = [f"/arm/controller/state/joint_{i}/measured_position_filtered" for i in range(900)]
    path = tmp_path / "log.csv"
    rows = "\n".join(",".join([str(t), *["0.5"] * len(names)]) for t in range(3))
    path.write_text(",".join(["time_s", *names]) + "\n" + rows + "\n")
    assert list(read_recording(path).columns) == names

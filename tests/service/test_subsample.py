"""Long recordings: stretches from begin to end stand for all, and that is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.recordings.recording import read_recording, write_recording
from edge_daemon.service.subsample import left_out, shortened


def test_a_long_recording_is_cut_to_stretches_from_begin_to_end_and_that_is_said(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 1000.0, 0.01)
    write_recording(tmp_path / "long.csv", time_s, {"theta_out_rad": 2.0 * time_s})
    long = read_recording(tmp_path / "long.csv")
    assert shortened([long], most=len(time_s)) == [long]
    parts = shortened([long], most=10_000)
    assert [len(part.time_s) for part in parts] == [2000] * 5  # of twenty seconds; shorter ones tell too little
    assert (parts[0].time_s[0], parts[-1].time_s[-1]) == (time_s[0], time_s[-1])
    for part in parts:
        np.testing.assert_allclose(np.diff(part.time_s), 0.01)
        np.testing.assert_allclose(part.columns["theta_out_rad"], 2.0 * part.time_s)
    (line,) = left_out([Path("long.csv")], [long], parts)
    assert "100000 rows" in line and "10% of it" in line


def test_a_stretch_in_which_the_drive_stands_is_left_out(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 1000.0, 0.01)
    stands = (time_s > 200.0) & (time_s < 600.0)
    write_recording(tmp_path / "long.csv", time_s, {"theta_out_rad": np.where(stands, 400.0, 2.0 * time_s)})
    parts = shortened([read_recording(tmp_path / "long.csv")], most=10_000)
    assert [part.time_s[0] for part in parts] == pytest.approx([0.0, 735.0, 980.0])


@pytest.mark.slow
def test_compare_says_that_it_did_not_take_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge_daemon.service.subsample.shortened.__defaults__", (76_000,))
    files = ["--out", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml")]
    assert main(["simulate", "--effect", "coulomb_friction", "--seconds", "80", *files]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml"), "--json", "-"]) == 0
    assert "80001 rows are more than is worked on at once" in capsys.readouterr().err

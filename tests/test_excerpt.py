"""Long recordings: stretches from begin to end stand for all, and that is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.acquire.recording import read_recording, write_recording
from edge_daemon.cli import main
from edge_daemon.excerpt import left_out, shortened


def test_a_long_recording_is_cut_to_stretches_from_begin_to_end_and_that_is_said(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 100.0, 0.01)
    write_recording(tmp_path / "long.csv", time_s, {"theta_out_rad": 2.0 * time_s})
    long = read_recording(tmp_path / "long.csv")
    assert shortened([long], most=len(time_s)) == [long]
    (short,) = shortened([long], most=1000)
    assert 990 <= len(short.time_s) <= 1000
    assert (short.time_s[0], short.time_s[-1]) == (time_s[0], time_s[-1])
    assert np.count_nonzero(np.diff(short.time_s) > 0.015) == 9  # ten stretches without a hole
    np.testing.assert_allclose(short.columns["theta_out_rad"], 2.0 * short.time_s)
    (line,) = left_out([Path("long.csv")], [long], [short])
    assert "10000 rows" in line and "1000 of them" in line


def test_compare_says_that_it_did_not_take_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("edge_daemon.excerpt.shortened.__defaults__", (30_000,))
    files = ["--out", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml")]
    assert main(["simulate", "--effect", "coulomb_friction", "--seconds", "40", *files]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml"), "--json", "-"]) == 0
    assert "40001 rows are more than is worked on at once" in capsys.readouterr().err

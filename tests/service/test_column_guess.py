"""What a bare file's columns are, told from values that another hand made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.service.uploaded_columns import keep_columns, preview


def bare(path: Path, ratio: float, time_unit: float, angle_unit: float, mark: str, rest_s: float = 2.0) -> Path:
    """Time, a temperature, the output, a current and the motor, from a joint that rests at first."""
    rng = np.random.default_rng(3)
    time_s = np.arange(20_000) / 1000.0
    output = np.where(time_s > rest_s, 0.8 * np.sin(1.3 * (time_s - rest_s)) + 0.2, 0.2)
    motor = ratio * (output + 1e-3 * np.sin(2 * np.pi * time_s)) + 40.0
    others = 25.0 + 0.1 * rng.normal(size=len(time_s)), 3.0 * np.cos(time_s) + 0.1 * rng.normal(size=len(time_s))
    columns = time_s * time_unit + 5.0, others[0], output * angle_unit, others[1], motor * angle_unit
    lines = (mark.join(f"{value:.9g}" for value in row) for row in np.column_stack(columns))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("ratio", [100.0, -50.0, 161.0])
@pytest.mark.parametrize(("time_unit", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us")])
@pytest.mark.parametrize(("angle_unit", "angle", "mark"), [(1.0, "rad", ","), (180 / np.pi, "deg", ";")])
def test_time_and_both_angles_are_told_with_unit_and_sign(
    tmp_path: Path, ratio: float, time_unit: float, unit: str, angle_unit: float, angle: str, mark: str
) -> None:
    found = preview(bare(tmp_path / "r.csv", ratio, time_unit, angle_unit, mark))["columns"]
    assert [(row["channel"], row["unit"], row["reverse"]) for row in found] == [
        ("time_s", unit, False), ("", "", False), ("theta_out_rad", angle, False), ("", "", False),
        ("theta_in_rad", angle, ratio < 0),
    ]  # fmt: skip
    assert not preview(tmp_path / "r.csv")["ready"], "a person says that it is so"
    keep_columns(tmp_path / "r.csv", found)
    assert preview(tmp_path / "r.csv")["ready"]


def test_nothing_is_guessed_where_the_values_do_not_say(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    noise = "\n".join(",".join(f"{value:.4f}" for value in row) for row in rng.normal(size=(500, 3)))
    (tmp_path / "n.csv").write_text(noise)
    assert {row["channel"] for row in preview(tmp_path / "n.csv")["columns"]} == {""}
    (tmp_path / "s.csv").write_text("1,2,3\n2,3,4\n")
    assert {row["channel"] for row in preview(tmp_path / "s.csv")["columns"]} == {""}

"""A drive engineer's CSV and its usual mistakes: the line that a command prints names the file and what was meant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.recordings.recording import read_recording
from edge_daemon.service.column_check import coarse

TIME_S = np.arange(0.0, 12.0, 0.01)
ANGLE = 0.8 * np.sin(2.1 * TIME_S) + 0.3 * np.sin(5.3 * TIME_S)
CURRENT = 1.4 * np.sign(np.gradient(ANGLE)) + 0.2 * np.cos(2.1 * TIME_S)


def refused(folder: Path, capsys: pytest.CaptureFixture[str], text: str, balance: str = "drive") -> str:
    """The one line on standard error about a recording of this text, its file's name left out."""
    first = "inertia" if balance == "drive" else "linear_stiffness"
    (folder / "m.toml").write_text(f'[joint]\nbalance = "{balance}"\nratio = 101\n[[effect]]\nname = "{first}"\n')
    (folder / "rec.csv").write_text(text)
    assert main(["compare", str(folder / "rec.csv"), "--model", str(folder / "m.toml")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith(f"edge-daemon: {folder / 'rec.csv'}: ")
    return lines[0].removeprefix(f"edge-daemon: {folder / 'rec.csv'}: ")


def table(*names: str, time_s: np.ndarray = TIME_S, until: int | None = None) -> str:
    rows = zip(time_s[:until], ANGLE[:until], CURRENT[:until], strict=True)
    return ",".join(names) + "\n" + "\n".join(",".join(f"{cell:.6f}" for cell in row) for row in rows)


@pytest.mark.parametrize(
    ("names", "meant"),
    [
        (
            ("time_s", "theta_out_deg", "current_in_A"),
            "did you mean --map 'theta_out_rad=theta_out_deg*deg'?",
        ),
        (("time_s", "link pos [deg]", "current_in_A"), "did you mean --map 'theta_out_rad=link pos [deg]*deg'?"),
        (("time_s", "theta_out_rad", "current_in_mA"), "did you mean --map 'current_in_A=current_in_mA*0.001'?"),
        (
            ("time_s", "theta_out_counts", "current_in_A"),
            "'theta_out_counts' must be converted, and called theta_out_rad",
        ),
        (("time_s", "theta_out_rd", "current_in_A"), "did you mean --map 'theta_out_rad=theta_out_rd'?"),
        (("time_s", "theta_out_rad", "curent_in_A"), "did you mean --map 'current_in_A=curent_in_A'?"),
        (
            ("time_s", "theta_out_rad", "torque_out_Nm"),
            "if torque_out_Nm is the motor's, as seen at the output: --map torque_in_Nm=torque_out_Nm/RATIO",
        ),
        (("time_s", "position", "current_in_A"), "expected it beside position, current_in_A"),
    ],
)
def test_a_missing_column_is_told_with_the_one_that_was_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], names: tuple[str, ...], meant: str
) -> None:
    line = refused(tmp_path, capsys, table(*names))
    assert line.startswith("no column ") and line.endswith(meant)


def test_one_encoder_and_a_model_for_two_is_told_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(tmp_path, capsys, table("time_s", "theta_out_rad", "current_in_A"), balance="torsion")
    assert line.endswith("with one encoder only, the model's balance is 'drive'")


def test_what_the_physics_refuses_is_told_with_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = table("time_s", "theta_out_rad", "current_in_A", until=100)
    assert "s of motion without gaps: expected at least" in refused(tmp_path, capsys, text)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("Time", "Time"),
        ("t", "t"),
        ("time_ms", "time_ms*0.001"),
        ("timestamp", "timestamp"),
        ("time_s [s]", "time_s [s]"),
    ],
)
def test_a_column_that_is_probably_the_time_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, meant: str
) -> None:
    line = refused(tmp_path, capsys, table(name, "theta_out_rad", "current_in_A"))
    assert line.endswith(f"did you mean --map 'time_s={meant}'?")


@pytest.mark.parametrize("name", ["theta_out", "theta_out_rd"])
def test_a_misspelt_channel_in_a_formula_is_no_number_to_be_fitted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (tmp_path / "m.toml").write_text(
        '[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n'
        f'[[effect]]\nname = "mine"\nexpression = "a * sin({name})"\n'
    )
    (tmp_path / "rec.csv").write_text(table("time_s", "theta_out_rad", "current_in_A"))
    main(["compare", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml")])
    told = capsys.readouterr().out
    assert f"warning: mine: '{name}' is taken for a number to be fitted: is the channel 'theta_out_rad' meant?" in told
    assert "'a' is taken" not in told


def test_a_twist_sampled_at_100_hz_is_doubted_and_a_current_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.toml").write_text(
        '[joint]\nbalance = "torsion"\nratio = 100\noutput_inertia_kg_m2 = 0.1\n[[effect]]\nname = "linear_stiffness"\n'
    )
    rows = "\n".join(f"{t:.3f},{100 * a:.9f},{a:.9f}" for t, a in zip(TIME_S, ANGLE, strict=True))
    (tmp_path / "rec.csv").write_text(f"time_s,theta_in_rad,theta_out_rad\n{rows}\n")
    main(["compare", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml")])
    assert "sampled at 100 Hz: a twist takes 400 Hz" in capsys.readouterr().out
    assert not list(coarse("drive", [read_recording(tmp_path / "rec.csv")]))


def test_milliseconds_called_seconds_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.toml").write_text('[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n')
    (tmp_path / "ms.csv").write_text(table("time_s", "theta_out_rad", "current_in_A", time_s=1000 * TIME_S))
    assert main(["compare", str(tmp_path / "ms.csv"), "--model", str(tmp_path / "m.toml")]) == 2
    assert "10 from one row to the next: looks like milliseconds" in capsys.readouterr().err


def test_decimal_commas_between_commas_are_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "time_s,theta_out_rad,current_in_A\n" + "0,01,1,5,0,3\n" * 20
    assert "between cells with decimal commas stands a semicolon" in refused(tmp_path, capsys, text)


def test_decimal_commas_may_begin_below_a_row_of_whole_numbers(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text('[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n')
    head, *rows = table("time_s", "theta_out_rad", "current_in_A").splitlines()
    cells = [row.replace(",", ";").replace(".", ",") for row in rows[1:]]
    (tmp_path / "semi.csv").write_text("\n".join([head.replace(",", ";"), "0;0;0", *cells]))
    assert main(["compare", str(tmp_path / "semi.csv"), "--model", str(tmp_path / "m.toml")]) == 0


def test_what_is_wrong_with_the_model_is_told_with_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "drive.toml"
    model.write_text('[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n')
    (tmp_path / "rec.csv").write_text(table("time_s", "theta_out_rad", "current_in_A"))
    assert main(["map", str(tmp_path / "rec.csv"), "--model", str(model)]) == 2
    assert (
        capsys.readouterr().err
        == f"edge-daemon: {model}: joint.balance: 'drive': expected 'torsion': a stiffness wants two encoders\n"
    )


TO_AND_FRO = np.sin(2 * np.pi * 0.5 * TIME_S)
FRICTION = np.sign(np.cos(2 * np.pi * 0.5 * TIME_S)) + 0.3 * np.cos(2 * np.pi * 0.5 * TIME_S)
SPEED = np.pi * np.cos(2 * np.pi * 0.5 * TIME_S)


@pytest.mark.parametrize(
    ("angle", "speed", "current", "scale", "told"),
    [
        (TO_AND_FRO, SPEED, FRICTION, 1e3, "--map time_s=time_s*0.001"),
        (TO_AND_FRO, SPEED, FRICTION, 1e6, "microseconds"),
        (TO_AND_FRO, SPEED, -FRICTION, 1.0, "--map current_in_A=-current_in_A"),
        (TO_AND_FRO, -SPEED, FRICTION, 1.0, "--map velocity_out_rad_s=-velocity_out_rad_s"),
        (np.degrees(TO_AND_FRO), SPEED, FRICTION, 1.0, "--map theta_out_rad=theta_out_rad*deg"),
        (TO_AND_FRO, np.degrees(SPEED), FRICTION, 1.0, "--map velocity_out_rad_s=velocity_out_rad_s*deg"),
        (SPEED, TO_AND_FRO, FRICTION, 1.0, "exchanged"),
    ],
)
def test_a_wrong_unit_sign_or_column_is_told_before_any_fit(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    angle: np.ndarray,
    speed: np.ndarray,
    current: np.ndarray,
    scale: float,
    told: str,
) -> None:
    (tmp_path / "m.toml").write_text('[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n')
    columns = np.stack((scale * TIME_S, angle, speed, current), axis=1)
    names = "time_s,theta_out_rad,velocity_out_rad_s,current_in_A"
    np.savetxt(tmp_path / "rec.csv", columns, delimiter=",", header=names, comments="", fmt="%.9g")
    assert main(["diagnose", str(tmp_path / "rec.csv"), "--model", str(tmp_path / "m.toml")]) == 2
    assert told in capsys.readouterr().err


def test_columns_without_header_are_named_once_and_kept_beside_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "m.toml").write_text('[joint]\nbalance = "drive"\nratio = 101\n[[effect]]\nname = "inertia"\n')
    file, model = tmp_path / "rec.csv", str(tmp_path / "m.toml")
    columns = np.stack((1e3 * TIME_S, np.degrees(TO_AND_FRO), SPEED, 1e3 * FRICTION), axis=1)
    np.savetxt(file, columns, delimiter=",", fmt="%.9g")
    assert main(["compare", str(file), "--model", model]) == 2
    assert "line 1 holds numbers: name the columns with --columns" in capsys.readouterr().err
    named = ["--columns", "t_ms,q,_,i_mA", "--map", "time_s=t_ms*1e-3"]
    assert main(["compare", str(file), "--model", model, *named]) == 2, "no angle yet"
    named += ["--map", "theta_out_rad=q*deg", "--map", "current_in_A=i_mA/10**3"]
    assert main(["compare", str(file), "--model", model, *named]) == 0
    assert main(["compare", str(file), "--model", model]) == 0
    assert "rec.csv.columns.toml" in capsys.readouterr().out
    recording = read_recording(file)
    np.testing.assert_allclose(recording.columns["theta_out_rad"], TO_AND_FRO, atol=1e-7)
    np.testing.assert_allclose(recording.columns["current_in_A"], FRICTION, atol=1e-6)
    assert "_" not in recording.columns
    for formula in ("__import__('os')", "i_mA**", "i_mA*" * 40 + "1"):
        assert main(["compare", str(file), "--model", model, "--map", f"current_in_A={formula}"]) == 2
        assert "--map current_in_A" in capsys.readouterr().err
    for formula in ("9**9**9**9*i_mA", "(-2)**0.5*i_mA"):
        assert main(["compare", str(file), "--model", model, "--map", f"current_in_A={formula}"]) == 2
        assert capsys.readouterr().err.count("\n") == 1

"""The commands as an engineer types them: an effect is hidden, found, added, and the error falls."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
import tomllib
import wave
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main

SECONDS = "12"
SEED = "7"
HIDDEN = "coulomb_friction"
BASE = ("linear_stiffness", "viscous_damping")
NEAR_TRUE = 1.3
"""error after `add` over that of the true model"""


@dataclass(frozen=True, slots=True)
class Bench:
    """A recording with Coulomb friction in it, and the model one would begin with."""

    recording: Path
    model: Path

    def own_model(self, folder: Path) -> Path:
        """A copy that a test may change."""
        return Path(shutil.copy(self.model, folder / "own.toml"))

    def table(self) -> tuple[list[str], np.ndarray]:
        """Header and rows (n, columns)."""
        with self.recording.open() as file:
            header = file.readline().strip().split(",")
        return header, np.loadtxt(self.recording, delimiter=",", skiprows=1)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("practice")
    made = Bench(folder / "rec.csv", folder / "model.toml")
    arguments = ["--effect", HIDDEN, "--out", str(made.recording), "--model", str(made.model)]
    assert main(["simulate", *arguments, "--seconds", SECONDS, "--seed", SEED]) == 0
    return made


def asked(capsys: pytest.CaptureFixture[str], *arguments: object) -> Any:
    """What a command prints with `--json -`: one JSON document and nothing else."""
    capsys.readouterr()
    assert main([*map(str, arguments), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line with which a command ends in exit code 2."""
    capsys.readouterr()
    assert main([*map(str, arguments)]) == 2
    said = capsys.readouterr().err
    lines = [line for line in said.splitlines() if line.startswith("edge-daemon: ")]
    assert len(lines) == 1 and "Traceback" not in said, said
    assert said.rstrip().splitlines()[-1] == lines[0]
    return lines[0]


def error(document: Any) -> float:
    return float(document["error"]["nrmse"])


# the story


@pytest.mark.slow
def test_a_hidden_effect_is_named_added_and_the_error_falls(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = bench.own_model(tmp_path)
    before = asked(capsys, "compare", bench.recording, "--model", model)
    assert {"error", "where", "parameters"} <= set(before)
    assert set(before["error"]) == {"nrmse", "noise_floor_nrmse", "rmse", "unit"}
    assert {"axis", "share", "detail"} <= set(before["where"][0])

    found = asked(capsys, "diagnose", bench.recording, "--model", model)
    assert {"verdict", "error", "candidates", "next_experiment"} <= set(found)
    assert found["verdict"] == "missing"
    first = found["candidates"][0]
    keys = {"effect", "nrmse_before", "nrmse_after", "probability", "confused_with", "parameters"}
    assert keys <= set(first) and first["effect"] == HIDDEN
    known = sum(row["probability"] for row in found["candidates"])
    assert 0 <= known <= 1 + 1e-9
    assert main(["diagnose", str(bench.recording), "--model", str(model)]) == 0
    told = dict(
        re.findall(r"^(\S+|none of them) +(?:[\d.]+%[ *]+)*(\d\.\d\d)\b", capsys.readouterr().out, re.MULTILINE)
    )
    assert float(told[HIDDEN]) == pytest.approx(first["probability"], abs=0.006)
    assert float(told.get("none of them", 0)) == pytest.approx(1 - known, abs=0.006)

    assert main(["add", first["effect"], "--model", str(model), "--recording", str(bench.recording)]) == 0
    said = capsys.readouterr().out
    assert HIDDEN in said and "->" in said
    after = asked(capsys, "compare", bench.recording, "--model", model)

    true = tmp_path / "true.toml"
    true.write_text(bench.model.read_text() + f'\n[[effect]]\nname = "{HIDDEN}"\n')
    best = asked(capsys, "compare", bench.recording, "--model", true)
    assert error(after) <= NEAR_TRUE * error(best)
    assert error(after) < 0.2 * error(before)
    assert error(after) < 3 * after["error"]["noise_floor_nrmse"]


def test_add_tells_the_numbers_that_it_brings(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A channel that is misspelt in a formula is a number to be fitted, and shows up as one."""
    model = bench.own_model(tmp_path)
    formula = ["--expression", "a * sign(twist_rate_rad_s) + b * grease_degC"]
    assert main(["add", "mine", *formula, "--model", str(model), "--recording", str(bench.recording)]) == 0
    brought = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("mine ")]
    assert brought == ["a", "b", "grease_degC"]


@pytest.mark.slow
def test_reports_stand_alone(bench: Bench, tmp_path: Path) -> None:
    page = tmp_path / "compare.html"
    assert main(["compare", str(bench.recording), "--model", str(bench.model), "--report", str(page)]) == 0
    text = page.read_text()
    assert text.lstrip().lower().startswith("<!doctype html")
    assert 'src="http' not in text and 'href="http' not in text


def test_what_simulate_hides_reveal_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record, again = tmp_path / "a.csv", tmp_path / "b.csv"
    for file in (record, again):
        assert main(["simulate", "--hidden", "4", "--out", str(file), "--seconds", "2"]) == 0
    said = capsys.readouterr().out
    assert record.read_bytes() == again.read_bytes()
    assert main(["reveal", str(record)]) == 0
    answer = capsys.readouterr().out.splitlines()[0]
    assert answer.startswith("hidden: ")
    for name in answer.removeprefix("hidden: ").split(" + "):
        assert name not in said and name not in record.read_text()[:200]


def test_reveal_needs_the_seal(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert bench.recording.name in refused(capsys, "reveal", bench.recording)


def test_fit_writes_value_sd_unit_and_identified(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = bench.own_model(tmp_path)
    assert main(["fit", str(bench.recording), "--model", str(model)]) == 0
    rows = tomllib.loads(model.read_text())["effect"]
    assert [row["name"] for row in rows] == list(BASE)
    for row in rows:
        for parameter in row["parameters"].values():
            assert {"value", "sd", "unit", "identified"} <= set(parameter)
            assert parameter["sd"] > 0 and isinstance(parameter["identified"], bool)
    stiffness = next(iter(rows[0]["parameters"].values()))
    assert stiffness["unit"] == "N m/rad" and 2e4 <= stiffness["value"] <= 4.5e4  # the gears that are drawn


# what is refused, or doubted by name


def damaged(bench: Bench, kind: str, folder: Path) -> Path:
    """The recording with one thing wrong."""
    header, rows = bench.table()
    motor, out = header.index("theta_in_rad"), header.index("theta_out_rad")
    if kind == "one row":
        rows = rows[:1]
    elif kind == "constant":
        rows[:, [motor, out]] = 1.0
    elif kind == "NaN":
        rows[np.random.default_rng(1).random(len(rows)) < 0.7, out] = np.nan
    elif kind == "degrees":
        rows[:, out] = np.degrees(rows[:, out])
    elif kind == "all in degrees":
        rows[:, [motor, out]] = np.degrees(rows[:, [motor, out]])
    elif kind == "wrong sign":
        rows[:, out] *= -1
    elif kind == "too short":
        rows = rows[:300]
    file = folder / "damaged.csv"
    np.savetxt(file, rows, fmt="%.12g", delimiter=",", header=",".join(header), comments="")
    return file


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("one row", "row"),
        ("constant", "constant"),
        ("NaN", "no number"),
        ("degrees", "theta_out_rad looks like degrees"),
        ("wrong sign", "sign"),
        ("too short", "expected at least"),
    ],
)
@pytest.mark.parametrize("command", ["compare", "diagnose", "fit"])
def test_a_recording_that_cannot_be_used_is_refused_in_one_line(
    command: str, kind: str, word: str, bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = bench.own_model(tmp_path)
    untouched = model.read_text()
    assert word in refused(capsys, command, damaged(bench, kind, tmp_path), "--model", model)
    assert model.read_text() == untouched


def test_every_angle_in_degrees_is_suspected(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(damaged(bench, "all in degrees", tmp_path)), "--model", str(bench.model)]) == 0
    said = capsys.readouterr()
    assert "degrees" in said.out + said.err


@pytest.mark.parametrize("content", [None, "", "time_s,theta_in_rad,theta_out_rad\n"])
@pytest.mark.parametrize("command", ["compare", "diagnose", "fit"])
def test_a_missing_or_empty_file_is_named(
    command: str, content: str | None, bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "absent.csv"
    if content is not None:
        file.write_text(content)
    said = refused(capsys, command, file, "--model", bench.model)
    assert "absent.csv" in said or "rows" in said


@pytest.mark.parametrize("command", ["compare", "diagnose", "fit"])
def test_a_flawed_recording_leaves_standard_output_to_the_json(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, model = tmp_path / "flawed.csv", tmp_path / "model.toml"
    assert main(["simulate", "--out", str(file), "--model", str(model), "--seconds", SECONDS]) == 0
    rows = file.read_text().splitlines()
    rows[500] = rows[500].split(",")[0] + ",nan,nan,nan"
    file.write_text("\n".join([*rows[:800], rows[799], *rows[800:3000], *rows[3050:]]) + "\n")
    capsys.readouterr()
    assert main([command, str(file), "--model", str(model), "--json", "-"]) == 0
    said = capsys.readouterr()
    assert isinstance(json.loads(said.out), dict)
    assert "repeated" in said.err and "no value" in said.err and "gap" in said.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("--seed", "-1"),
        ("--hidden", "-1"),
        ("--bits", "99"),
        ("--seconds", "nan"),
        ("--seconds", "0.001"),
        ("--model", "no/folder/m.toml"),
        ("--effect", "kinematik_error"),
    ],
)
def test_simulate_refuses_what_it_cannot_do(
    arguments: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = arguments if "--seconds" in arguments else (*arguments, "--seconds", "2")
    assert arguments[1] in refused(capsys, "simulate", "--out", tmp_path / "x.csv", *given)


def test_simulate_guesses_at_a_mistyped_effect(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for balance, typed, meant in (
        ("torsion", "bakclash", "backlash"),
        ("drive", "sublinear_frictoin", "sublinear_friction"),
    ):
        words = ("simulate", "--out", tmp_path / "x.csv", "--seconds", "1", "--balance", balance, "--effect", typed)
        assert f"did you mean {meant!r}" in refused(capsys, *words)


@pytest.mark.parametrize("words", [[], ["compair"], ["compare", "x.csv"], ["registers", "--format", "xml"]])
def test_a_mistake_on_the_command_line_is_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(words)
    said = capsys.readouterr()
    assert said.out == "" and len(said.err.splitlines()) == 1
    assert said.err.startswith("edge-daemon: ") and "--help" in said.err


def test_a_full_disk_behind_standard_output_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "edge_daemon", "registers"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert done.returncode == 2 and done.stderr == "edge-daemon: no space left for what is to be written\n"


def test_a_closed_standard_output_is_no_traceback() -> None:
    command = ["/bin/sh", "-c", f"{sys.executable} -m edge_daemon effects --json >&-"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_missing_model_is_named(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "none.toml" in refused(capsys, "compare", bench.recording, "--model", tmp_path / "none.toml")


def test_an_unknown_effect_gets_a_suggestion(bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = bench.own_model(tmp_path)
    said = refused(capsys, "add", "coulomb_frictoin", "--model", model, "--recording", bench.recording)
    assert "did you mean 'coulomb_friction'" in said
    assert model.read_text() == bench.model.read_text()
    assert "wobble" in refused(capsys, "simulate", "--effect", "wobble", "--out", tmp_path / "x.csv")


@pytest.mark.parametrize(
    ("right", "typo", "word"),
    [
        ("output_inertia_kg_m2", "output_inertia_kgm2", "output_inertia_kgm2"),
        ('"linear_stiffness"', '"linear_stifness"', "linear_stifness"),
        ('balance = "torsion"', 'balance = "torsoin"', "torsoin"),
        ("[joint]", "[joint", "model"),
        ("ratio = 100.0", 'ratio = "hundred"', "ratio"),
    ],
)
def test_a_typo_in_the_model_is_named(
    right: str, typo: str, word: str, bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.toml"
    text = bench.model.read_text()
    assert right in text
    model.write_text(text.replace(right, typo))
    assert word in refused(capsys, "compare", bench.recording, "--model", model)


def test_a_process_of_its_own_ends_with_2_and_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "edge_daemon", "compare", str(tmp_path / "no.csv"), "--model", "no.toml"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1 and done.stderr.startswith("edge-daemon: ")


# noise, life and the lists

RATE_HZ = 8000


def brown_and_white(seconds: float) -> np.ndarray:
    """(n,) sound whose density falls as f^-2 towards a white floor, within +-1."""
    rng = np.random.default_rng(11)
    count = int(RATE_HZ * seconds)
    frequency = np.fft.rfftfreq(count, 1 / RATE_HZ)
    density = 1 + (300 / np.maximum(frequency, 5.0)) ** 2
    sound = np.fft.irfft(np.fft.rfft(rng.normal(size=count)) * np.sqrt(density), count)
    return np.asarray(0.9 * sound / np.abs(sound).max())


def sound_file(kind: str, folder: Path) -> Path:
    """The same noise as WAV, as a waveform CSV or as a spectrum CSV."""
    file = folder / ("sound.wav" if kind == "wav" else "sound.csv")
    sound = brown_and_white(20.0)
    if kind == "wav":
        with wave.open(str(file), "wb") as out:
            out.setparams((1, 2, RATE_HZ, 0, "NONE", ""))
            out.writeframes((sound * 32767).astype("<i2").tobytes())
        return file
    if kind == "waveform":
        header, table = "time_s,sound", np.column_stack((np.arange(len(sound)) / RATE_HZ, sound))
    else:
        frequency = np.geomspace(10, 4000, 400)
        scatter = np.random.default_rng(2).gamma(1000, 1 / 1000, 400)
        density = (1 + (300 / frequency) ** 2) * scatter
        header, table = "frequency_hz,psd,averages", np.column_stack((frequency, density, np.full(400, 1000)))
    np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")
    return file


@pytest.mark.parametrize("kind", ["wav", "waveform", "spectrum"])
def test_noise_of_a_known_sound(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = asked(capsys, "noise", sound_file(kind, tmp_path))
    assert {"reference_hz", "coefficients", "averages", "iterations", "tones", "unit"} <= set(said)
    assert [row["beta"] for row in said["coefficients"]] == [0, 1, 2, 3, 4]
    for row in said["coefficients"]:
        assert {"value", "sd", "identified", "value_hz"} <= set(row) and row["sd"] > 0
    white, _, brown, *_ = said["coefficients"]
    assert white["identified"]
    falls = brown["value"] / white["value"] * (said["reference_hz"] / 300) ** 2
    sd = brown["sd"] / white["value"] * (said["reference_hz"] / 300) ** 2
    assert abs(falls - 1) < 4 * sd + 0.02


def test_noise_refuses_what_is_no_sound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "sound.wav"
    file.write_bytes(b"RIFFnothing")
    assert "sound.wav" in refused(capsys, "noise", file)
    assert "none.csv" in refused(capsys, "noise", tmp_path / "none.csv")


def test_life_of_a_history(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hours = np.arange(1.0, 1001.0)
    table = np.column_stack((hours, np.full(1000, 1500.0), np.full(1000, 40.0), np.full(1000, 70.0)))
    file = tmp_path / "history.csv"
    header = "time_h,speed_in_rpm,torque_cubic_mean_Nm,torque_peak_Nm"
    np.savetxt(file, table, fmt="%.9g", delimiter=",", header=header, comments="")
    said = asked(capsys, "life", file, "--gear", "CSG-20-100")
    assert set(said) == {"time_h", "damage", "rul_h", "failure_probability", "state", "reasons"}
    assert said["time_h"] == 1000.0
    assert 0 < said["rul_h"]["p10"] < said["rul_h"]["p50"] < said["rul_h"]["p90"]
    assert all({"within_h", "probability"} == set(row) for row in said["failure_probability"])
    assert "CSG-20-999" in refused(capsys, "life", file, "--gear", "CSG-20-999")


def test_the_catalogue_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["effects", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["effects"]
    assert {HIDDEN, *BASE} <= {row["name"] for row in rows if row["balance"] == "torsion"}
    for row in rows:
        assert row["equation"] and row["source"] and row["meaning"]
        assert all(parameter["unit"] for parameter in row["parameters"])


def test_the_register_map_as_csv(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["registers", "--format", "csv"]) == 0
    rows = list(csv.reader(capsys.readouterr().out.splitlines()))
    assert rows[0] == ["name", "address", "type", "unit", "meaning"]
    assert len(rows) > 20 and len({row[0] for row in rows}) == len(rows)
    addresses = [int(row[1]) for row in rows[1:]]
    assert addresses == sorted(set(addresses))

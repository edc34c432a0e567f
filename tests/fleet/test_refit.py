"""Models of many units fitted anew when an effect has come to the catalogue."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from edge_daemon.cli import main
from edge_daemon.effects.model_file import read_model

MODEL = '[joint]\nbalance = "torsion"\nratio = 100.0\noutput_inertia_kg_m2 = 0.05\n'
HAVE = {"a": (), "hall/b": ("coulomb_friction",), "hall/c": ("coulomb_friction",)}
"""What the simulated gears have beside stiffness and damping."""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    for at, (unit, effects) in enumerate(HAVE.items()):
        (folder / unit).mkdir(parents=True)
        names = [word for name in effects or ("linear_stiffness",) for word in ("--effect", name)]
        words = ["simulate", *names, "--seconds", "8", "--seed", str(at), "--out", str(folder / unit / "r.parquet")]
        assert main(words) == 0
        rows = "".join(f'[[effect]]\nname = "{name}"\n' for name in ("linear_stiffness", "viscous_damping"))
        (folder / unit / "model.toml").write_text(MODEL + rows)
    (folder / "broken").mkdir()
    (folder / "broken" / "model.toml").write_text("[joint]\n")
    (folder / "broken" / "r.csv").write_text("time_s\n0\n")
    (folder / "empty").mkdir()
    return folder


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, dict[str, Any]]:
    capsys.readouterr()
    assert main(["fleet", "refit", *words, "--json", "-"]) == 0
    return {row["unit"]: row for row in json.loads(capsys.readouterr().out)["units"]}


@pytest.mark.slow
def test_an_effect_stays_where_the_gear_has_it_and_one_bad_unit_stops_nobody(
    fleet: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {unit: (fleet / unit / "model.toml").read_bytes() for unit in HAVE}
    found = told(capsys, str(fleet), "--effect", "coulomb_friction")
    assert set(found) == {*HAVE, "broken"} and "joint" in found["broken"]["left_out"]
    assert {unit for unit in HAVE if found[unit]["kept"]} == {unit for unit, effects in HAVE.items() if effects}
    for unit in ("hall/b", "hall/c"):
        assert found[unit]["nrmse_after"] < 0.3 * found[unit]["nrmse_before"]
    assert {unit: (fleet / unit / "model.toml").read_bytes() for unit in HAVE} == before, "nothing without --write"
    in_the_hall = {name.removeprefix("hall/"): row for name, row in found.items() if name.startswith("hall/")}
    written = told(capsys, str(fleet / "hall"), "--effect", "coulomb_friction", "--write")
    assert {unit: row["nrmse_after"] for unit, row in written.items()} == {
        unit: row["nrmse_after"] for unit, row in in_the_hall.items()
    }
    for unit, effects in HAVE.items():
        model = read_model(fleet / unit / "model.toml")
        assert [row.name for row in model.effects] == ["linear_stiffness", "viscous_damping", *effects]
        assert unit == "a" or model.value("linear_stiffness", "stiffness") > 0.0
    again = told(capsys, str(fleet / "hall" / "b"), "--effect", "coulomb_friction")
    (unit,) = again.values()
    assert unit["kept"] and unit["nrmse_after"] == pytest.approx(found["hall/b"]["nrmse_after"], rel=0.01)


def test_a_folder_without_units_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "refit", str(tmp_path)]) == 2
    assert "expected one for each unit" in capsys.readouterr().err

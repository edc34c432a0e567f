"""The optimum: nothing near it is better, constraints hold, and what has none is refused."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.design.drawing import DesignError, drawing_of
from edge_daemon.design.evaluate import Figures, figures
from edge_daemon.design.life import gear_of, gear_text, life_curve, life_h
from edge_daemon.design.optimise import document_of, optimise
from edge_daemon.design.solve import solve
from edge_daemon.text import written_as_json
from edge_daemon.usage.damage import damage_law
from edge_daemon.usage.gears import find_gear

pytestmark = pytest.mark.slow

pytest.importorskip("skfem")
CUP: dict[str, Any] = {
    "flexspline": {
        "mean_radius_mm": 25.0,
        "length_mm": 30.0,
        "wall_mm": 0.35,
        "rim_width_mm": 10.0,
        "rim_thickness_mm": 0.9,
        "diaphragm_thickness_mm": 0.5,
        "hub_radius_mm": 12.0,
        "fillet_mm": 0.5,
    },
    "teeth": {"flexspline": 200, "circular_spline": 202, "module_mm": 0.25},
    "wave_generator": {"shape": "cosine", "radial_deflection_mm": 0.25, "contact": "line"},
    "material": {"name": "18Ni300"},
    "load": {"torque_Nm": 50.0},
    "optimise": {
        "bounds": {"wall_mm": [0.2, 0.6], "diaphragm_thickness_mm": [0.3, 0.8]},
        "stiffness_min_Nm_per_rad": 45000.0,
        "front_points": 2,
    },
}

WEAK: dict[str, Any] = {"wave_generator": {"radial_deflection_mm": 0.9}, "material": {"name": "40CrNiMoA"}}


def changed(**sections: dict[str, Any]) -> dict[str, Any]:
    return CUP | {name: {**CUP.get(name, {}), **keys} for name, keys in sections.items()}


@pytest.fixture(scope="module")
def grid() -> list[Figures]:
    """Designs of a plain grid of the same two variables, which knows nothing of the search, that are stiff enough."""
    tried = [
        figures(drawing_of(changed(flexspline={"wall_mm": wall, "diaphragm_thickness_mm": disc})))
        for wall in np.linspace(0.2, 0.6, 9).tolist()
        for disc in np.linspace(0.3, 0.8, 9).tolist()
    ]
    return [design for design in tried if design.solved.stiffness_Nm_per_rad >= 45000]


@pytest.mark.timeout(400)
@pytest.mark.parametrize("weights", [[1.0, 500.0, 0.1], [0.2, 100.0, 0.5]])
def test_no_other_design_within_the_bounds_is_better_by_one_percent(weights: list[float], grid: list[Figures]) -> None:
    found = document_of(
        optimise(drawing_of(changed(optimise={**CUP["optimise"], "weights": weights})), lambda what, share: None)
    )
    assert found["best"]["torsional_stiffness_Nm_per_rad"] >= 45000 * 0.999
    aims = [
        (design.stresses.von_mises_Pa * 1e-6, design.deflection_m * 1e3, design.solved.volume_m3 * 1e9)
        for design in grid
    ]
    assert found["best"]["objective"] <= 1.002 * min(float(np.dot(weights, one)) for one in aims)
    assert found["binding"] and found["front"]
    assert written_as_json(found, None) is False


@pytest.mark.parametrize(
    ("wishes", "word"),
    [
        ({"bounds": {"colour_mm": [0, 1]}}, "colour_mm"),
        ({"bounds": {"wall_mm": [0.5, 0.2]}}, "wall_mm"),
        ({"bounds": {"wall_mm": [0.3, 0.4]}, "safety_min": 90.0, "front_points": 0}, "safety_min"),
        ({"bounds": {"hub_radius_mm": [26.0, 30.0]}, "front_points": 0}, "hub_radius_mm"),
    ],
)
def test_what_cannot_be_had_is_refused_with_the_reason(wishes: dict[str, Any], word: str) -> None:
    with pytest.raises(DesignError, match=word):
        optimise(drawing_of(changed() | {"optimise": wishes}), lambda what, share: None)


def test_a_design_becomes_a_gear_whose_law_is_its_own_curve(tmp_path: Path) -> None:
    drawing = drawing_of(changed(wave_generator={"radial_deflection_mm": 0.4}, teeth={"module_mm": 0.25}))
    solved = solve(drawing)
    curve = life_curve(solved)
    path = tmp_path / "gear.toml"
    path.write_text(gear_text(gear_of(solved, curve, "mine")))
    gear = find_gear(str(path))
    assert gear.ratio == 100.0 and gear.stiffness_3_Nm_per_rad < solved.stiffness_Nm_per_rad
    law = damage_law(gear)
    assert 1 / float(law.per_cycle(gear.momentary_peak_Nm)) == pytest.approx(1e4)
    assert tomllib.loads(path.read_text())["name"] == "mine"


def test_more_load_is_less_life_and_a_light_one_has_no_end() -> None:
    curve = life_curve(solve(drawing_of(changed(**WEAK))))
    lives = [life_h(curve, [(torque, 2000.0, 1.0)]) for torque in (100.0, 300.0, 500.0)]
    assert lives[0] > lives[1] > lives[2] > 0.0
    half = life_h(curve, [(300.0, 2000.0, 1.0), (300.0, 1000.0, 1.0)])
    assert half == pytest.approx(lives[1] / 0.75)
    strong = life_curve(solve(drawing_of(changed())))
    assert strong.endless_Nm > 0.0 and life_h(strong, [(0.5 * strong.endless_Nm, 2000.0, 1.0)]) == math.inf


def test_compare_and_report_by_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import tomlkit

    a, b, history = tmp_path / "a.toml", tmp_path / "b.toml", tmp_path / "history.csv"
    history.write_text("time_h,speed_in_rpm,torque_cubic_mean_Nm\n0,2000,300\n1,1500,350\n2,2000,300\n")
    load = {"torque_Nm": 50.0, "spectrum": "history.csv", "stiffness_Nm_per_rad": 25000.0}
    a.write_text(tomlkit.dumps(changed(load=load, **WEAK)))
    b.write_text(tomlkit.dumps(changed(flexspline={"wall_mm": 0.45}, **WEAK)))
    page = tmp_path / "page.html"
    assert main(["design", "compare", str(a), str(b), "--json", "-", "--report", str(page)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["change"]["torsional_stiffness_Nm_per_rad"] > 0.0
    assert document["b"]["life_h"] > document["a"]["life_h"] > 0.0
    assert page.read_text().count("<svg") >= 4
    history.write_text("time_h,speed_in_rpm\n0,2000\n1,1500\n")
    assert main(["design", "evaluate", str(a)]) == 2
    assert "torque_cubic_mean_Nm" in capsys.readouterr().err

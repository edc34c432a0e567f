"""A cup's figures against an independent solver's, and what is refused."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.design.drawing import DesignError, drawing_of
from edge_daemon.design.evaluate import evaluate, figures
from edge_daemon.design.shapes import deflection
from edge_daemon.design.solve import solve
from edge_daemon.design.tooth_load import tooth_forces

pytest.importorskip("skfem")
CUP: dict[str, Any] = {
    "flexspline": {
        "kind": "cup",
        "mean_radius_mm": 25.0,
        "length_mm": 30.0,
        "wall_mm": 0.35,
        "rim_width_mm": 10.0,
        "rim_thickness_mm": 0.9,
        "diaphragm_thickness_mm": 0.5,
        "hub_radius_mm": 12.0,
        "fillet_mm": 0.5,
        "back_cone_deg": 0.0,
    },
    "teeth": {"flexspline": 200, "circular_spline": 202, "module_mm": 0.25, "profile": "involute"},
    "wave_generator": {"shape": "cosine", "radial_deflection_mm": 0.25, "contact": "bore"},
    "material": {"name": "18Ni300"},
    "load": {"torque_Nm": 50.0, "speed_in_rpm": 2000.0},
}


def changed(**sections: dict[str, Any]) -> dict[str, Any]:
    document = copy.deepcopy(CUP)
    for section, keys in sections.items():
        document[section] = {**document.get(section, {}), **keys}
    return document


def test_the_reference_cup_has_the_figures_of_an_independent_solver() -> None:
    """The same cup by another solver of the same kind: 50 600 N m/rad, 36.4 MPa, 3 304 mm3; hoop 389 and von Mises 705
    MPa with the bore held, 118 and 191 with one line."""
    bore = evaluate(drawing_of(CUP))
    assert bore["torsional_stiffness_Nm_per_rad"] == pytest.approx(50600, rel=0.01)
    assert bore["stress_shear_MPa"] == pytest.approx(36.4, rel=0.005)
    assert bore["volume_mm3"] == pytest.approx(3304, rel=0.001)
    assert bore["stress_hoop_max_MPa"] == pytest.approx(389, rel=0.03)
    assert bore["stress_von_mises_max_MPa"] == pytest.approx(705, rel=0.03)
    assert bore["where"]["part"] == "step of the rim"
    line = evaluate(drawing_of(changed(wave_generator={"contact": "line"})))
    assert line["stress_hoop_max_MPa"] == pytest.approx(118, rel=0.03)
    assert line["stress_von_mises_max_MPa"] == pytest.approx(191, rel=0.03)
    assert line["where"]["part"] == "diaphragm at the hub"
    assert all(abs(share) < 0.03 for share in line["mesh"]["change_on_refinement"].values())


def test_a_wider_rigid_contact_bends_the_rim_harder() -> None:
    """From 0.7 to 10 mm an independent solver says 127 to 400 MPa of hoop stress at the open end."""
    hoop = []
    for width in (0.7, 3.0, 10.0):
        drawing = drawing_of(changed(wave_generator={"contact": "one-sided", "contact_width_mm": width}))
        hoop.append(figures(drawing).stresses.hoop_Pa * 1e-6)
    assert hoop[0] == pytest.approx(127, rel=0.03) and hoop[2] == pytest.approx(400, rel=0.1)
    assert hoop[0] < hoop[1] < hoop[2]


def test_one_side_only_pushes_and_is_nowhere_left_behind() -> None:
    drawing = drawing_of(changed(wave_generator={"shape": "ellipse", "contact": "one-sided", "contact_width_mm": 4.0}))
    solved = solve(drawing)
    pressed = solved.pressed
    assert (pressed.force_N_per_rad >= 0.0).all() and pressed.force_N_per_rad.max() > 0.0
    rows = [
        int(np.argmin(np.hypot(*(solved.rings.nodes - [solved.mesh.points[0, 0, 0], z]).T))) for z in pressed.places_m
    ]
    out = solved.displacement(pressed.angles_rad)[:, rows, 0].T
    shape = 1e-3 * deflection(drawing.wave_generator, 24.825)(pressed.angles_rad)
    assert (out - shape).min() > -1e-9
    assert np.abs((out - shape) * (pressed.force_N_per_rad > 0.0)).max() < 1e-9


def test_a_soft_bearing_presses_less() -> None:
    peaks = []
    for stiffness in (1e6, 300.0, 30.0):
        generator = {"contact": "one-sided", "contact_width_mm": 6.0, "bearing_stiffness_N_per_mm3": stiffness}
        peaks.append(figures(drawing_of(changed(wave_generator=generator))).stresses.hoop_Pa)
    assert peaks[0] > peaks[1] > peaks[2]


@pytest.mark.parametrize("kind", ["cup", "silk_hat", "pancake"])
@pytest.mark.parametrize("shape", ["ellipse", "cosine", "four-force", "double-disc"])
def test_every_kind_goes_with_every_shape(kind: str, shape: str) -> None:
    flexspline = {"kind": kind, "hub_radius_mm": 38.0 if kind == "silk_hat" else 12.0}
    drawing = drawing_of(
        changed(flexspline=flexspline, wave_generator={"shape": shape, "contact": "one-sided", "contact_width_mm": 3.0})
    )
    found = figures(drawing, 0.67)
    assert 0.0 < found.stresses.bending_Pa < found.stresses.von_mises_Pa * 1.2
    assert found.deflection_m == pytest.approx(0.25e-3, rel=0.6) and found.solved.stiffness_Nm_per_rad > 1e4


def test_shapes_stand_out_by_their_deflection_and_enclose_what_the_bore_does() -> None:
    angles = np.linspace(0, 2 * math.pi, 721)[:-1]
    for shape in ("ellipse", "cosine", "four-force", "double-disc"):
        generator = drawing_of(changed(wave_generator={"shape": shape})).wave_generator
        out = deflection(generator, 24.8)(angles)
        assert out[0] == pytest.approx(0.25) and abs(out.mean()) < 1e-9
        assert out[180] == pytest.approx(-0.25, rel=0.35)


def test_a_measured_contour_is_its_own_shape() -> None:
    angles = np.arange(0, 360, 5.0)
    contour = [(float(a), 24.6 + 0.2 * math.cos(2 * math.radians(a - 20))) for a in angles]
    generator = {"shape": "measured", "contour": contour, "contact": "line"}
    found = figures(drawing_of(changed(wave_generator=generator)))
    same = figures(drawing_of(changed(wave_generator={"radial_deflection_mm": 0.2, "contact": "line"})))
    assert found.stresses.bending_Pa == pytest.approx(same.stresses.bending_Pa, rel=0.01)


def test_a_back_cone_a_profile_and_a_thick_diaphragm_are_drawn() -> None:
    plain = figures(drawing_of(CUP), 0.67).solved
    cone = figures(drawing_of(changed(flexspline={"back_cone_deg": 10.0})), 0.67).solved
    assert cone.mesh.points[-1, :, 1].mean() > plain.mesh.points[-1, :, 1].mean() + 2e-3
    same = figures(drawing_of(changed(flexspline={"wall_mm": [[0.0, 0.35], [30.0, 0.35]]})), 0.67).solved
    assert same.stiffness_Nm_per_rad == pytest.approx(plain.stiffness_Nm_per_rad, rel=1e-6)
    thick = figures(drawing_of(changed(flexspline={"wall_mm": [[11.0, 0.35], [29.0, 0.45]]})), 0.67).solved
    assert thick.stiffness_Nm_per_rad > 1.03 * plain.stiffness_Nm_per_rad


@pytest.mark.parametrize(
    ("section", "keys", "word"),
    [
        ("flexspline", {"hub_radius_mm": 26.0}, "hub_radius_mm"),
        ("flexspline", {"rim_width_mm": 29.0}, "length_mm"),
        ("flexspline", {"rim_width_mm": 31.0}, "rim_width_mm"),
        ("flexspline", {"wall_mm": -0.3}, "wall_mm"),
        ("flexspline", {"wall_mm": 1.2}, "rim_thickness_mm"),
        ("flexspline", {"fillet_mm": 12.8}, "flexspline"),
        ("flexspline", {"fillet_mm": 0.0}, "fillet_mm"),
        ("flexspline", {"mean_radius_mm": math.nan}, "mean_radius_mm"),
        ("flexspline", {"colour": "red"}, "colour"),
        ("flexspline", {"kind": "bowl"}, "kind"),
        ("teeth", {"circular_spline": 201}, "circular_spline"),
        ("teeth", {"circular_spline": 200}, "circular_spline"),
        ("teeth", {"module_mm": 0.5}, "module_mm"),
        ("wave_generator", {"radial_deflection_mm": 5.0}, "radial_deflection_mm"),
        ("wave_generator", {"contact": "one-sided", "contact_width_mm": 12.0}, "contact_width_mm"),
        ("material", {"name": "cheese"}, "cheese"),
        ("load", {"torque_Nm": math.inf}, "torque_Nm"),
    ],
)
def test_what_cannot_be_made_is_refused_with_the_reason(section: str, keys: dict[str, Any], word: str) -> None:
    with pytest.raises(DesignError, match=word):
        figures(drawing_of(changed(**{section: keys})))


def test_the_command_writes_the_contract(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cup.toml"
    path.write_text(_toml(CUP))
    assert main(["design", "evaluate", str(path), "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    for key in (
        *("stress_bending_MPa", "stress_shear_MPa", "stress_von_mises_max_MPa", "where", "deflection_max_mm"),
        *("volume_mm3", "mass_kg", "torsional_stiffness_Nm_per_rad", "safety_fatigue", "objective", "mesh"),
    ):
        assert key in document
    assert main(["design", "evaluate", str(path)]) == 0
    assert "step of the rim" in capsys.readouterr().out
    path.write_text(_toml(changed(flexspline={"hub_radius_mm": 30.0})))
    assert main(["design", "evaluate", str(path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def _toml(document: dict[str, Any]) -> str:
    lines = []
    for section, keys in document.items():
        lines += [f"[{section}]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    return "\n".join(lines) + "\n"


def test_numbers_without_strength_tell_no_safety_and_teeth_that_cannot_part_are_said() -> None:
    numbers = {"youngs_modulus_GPa": 200.0, "poisson": 0.3, "density_kg_m3": 7800.0}
    document = evaluate(drawing_of(changed(wave_generator={"contact": "line"}) | {"material": numbers}))
    assert math.isnan(document["safety_fatigue"]) and "ultimate_MPa" in " ".join(document["notes"])
    flat = evaluate(drawing_of(changed(wave_generator={"contact": "line", "radial_deflection_mm": 0.1})))
    assert "cannot be put together" in " ".join(flat["notes"])


def test_teeth_that_touch_at_once_share_alike() -> None:
    assert tooth_forces(np.array([0.0, math.nan, 0.0]), 30.0, 1e8) == pytest.approx([15.0, 0.0, 15.0])


def test_a_gap_is_closed_only_by_the_force_that_closes_it() -> None:
    """Three springs of 1e8 N/m that begin at 0, 1 and 3 um, worked out by hand."""
    gaps = 1e-6 * np.array([1.0, 0.0, 3.0])
    assert tooth_forces(gaps, 99.0, 1e8) == pytest.approx([0.0, 99.0, 0.0])
    assert tooth_forces(gaps, 300.0, 1e8) == pytest.approx([100.0, 200.0, 0.0])
    assert tooth_forces(gaps, 800.0, 1e8) == pytest.approx([300.0, 400.0, 100.0])
    assert tooth_forces(gaps + 5e-6, 800.0, 1e8) == pytest.approx([300.0, 400.0, 100.0]), "all turn together"


@pytest.mark.parametrize("profile", ["involute", "S"])
def test_the_teeth_of_both_lobes_carry_the_torque(profile: str) -> None:
    shares = []
    for torque in (5.0, 50.0, 200.0):
        teeth = {"profile": profile}
        document = evaluate(drawing_of(changed(load={"torque_Nm": torque}, teeth=teeth)))
        load = document["teeth"]["load"]
        assert load["torque_Nm"] == torque
        radius_m = 0.5e-3 * document["teeth"]["module_mm"] * CUP["teeth"]["flexspline"]
        carried = 2.0 * radius_m * sum(row["force_N"] for row in load["arc"])
        assert carried == pytest.approx(torque, rel=0.01), "less the teeth that are not listed"
        assert load["from_deg"] <= load["to_deg"] and 0.0 < load["loaded_share"] <= 1.0
        shares.append(load["loaded_share"])
    assert shares == sorted(shares) and shares[-1] > shares[0], "more torque reaches more teeth"


def test_without_torque_nothing_is_carried() -> None:
    assert evaluate(drawing_of(changed(load={"torque_Nm": 0.0})))["teeth"]["load"] is None

"""The catalogue of gears against the maker's own relations, and a user's file against its mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_daemon.usage.gears import GearError, catalogue, find_gear


def test_a_known_size_has_the_catalogue_figures() -> None:
    gear = find_gear("csg-20-100")
    assert (gear.rated_torque_Nm, gear.repeated_peak_Nm, gear.momentary_peak_Nm) == (52, 107, 191)
    assert (gear.stiffness_1_Nm_per_rad, gear.stiffness_3_Nm_per_rad) == (1.6e4, 2.9e4)
    assert (gear.corner_1_Nm, gear.corner_2_Nm) == (7, 25)
    assert (gear.l10_h, gear.l50_h, gear.ratio) == (10_000, 50_000, 100)
    assert find_gear("CSF-20-100").ratcheting_Nm == 260
    assert find_gear("CSF-20-100").buckling_Nm == 560


def test_csg_carries_thirty_percent_more_than_csf() -> None:
    """The maker's own statement; a slip of the keyboard in either row breaks it."""
    gears = catalogue()
    pairs = [(gear, gears[name.replace("CSG", "CSF")]) for name, gear in gears.items() if name.startswith("CSG")]
    assert len(pairs) == 21
    for strong, plain in pairs:
        assert strong.rated_torque_Nm / plain.rated_torque_Nm == pytest.approx(1.3, rel=0.025), strong.name
        assert strong.repeated_peak_Nm / plain.repeated_peak_Nm == pytest.approx(1.3, rel=0.025), strong.name


def test_limits_of_every_size_are_in_order() -> None:
    for gear in catalogue().values():
        limits = [gear.rated_torque_Nm, gear.repeated_peak_Nm, gear.momentary_peak_Nm, gear.ratcheting_Nm]
        assert limits == sorted(limits), gear.name
        assert gear.ratcheting_Nm < gear.buckling_Nm, gear.name
        stiffness = [gear.stiffness_1_Nm_per_rad, gear.stiffness_2_Nm_per_rad, gear.stiffness_3_Nm_per_rad]
        assert stiffness == sorted(stiffness), gear.name


def test_an_unknown_figure_is_none() -> None:
    assert find_gear("CSG-32-100").no_load_torque_Nm is None
    assert find_gear("CSG-20-50").no_load_torque_Nm is None


def test_an_unknown_size_names_its_neighbours() -> None:
    with pytest.raises(GearError, match=r"CSG-20-99.*CSG-20-50, CSG-20-80, CSG-20-100") as caught:
        find_gear("CSG-20-99")
    assert "\n" not in str(caught.value)


def test_a_users_gear(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('name = "own"\nratio = 51\nrated_torque_Nm = 30\nl10_h = 5000\nl50_h = 20000\n')
    gear = find_gear(str(path))
    assert (gear.name, gear.ratio, gear.momentary_peak_Nm) == ("own", 51, None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('name = "own"\nratio = 51\nrated_torque_Nm = -30\nl10_h = 5e3\nl50_h = 2e4', "rated_torque_Nm"),
        ('name = "own"\nratio = 51\nrated_torque_Nm = 30\nl10_h = 5e3\nl50_h = 2e3', "l50_h"),
        ('name = "own"\nratio = 51\nrated_torqe_Nm = 30\nl10_h = 5e3\nl50_h = 2e4', "rated_torqe_Nm"),
        ("name = ", "not valid TOML"),
    ],
)
def test_a_broken_file_is_refused_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(GearError, match=expected) as caught:
        find_gear(str(path))
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(GearError, match="cannot read"):
        find_gear("no/such/gear.toml")

"""Recordings: reproducible, in the right columns, with effects that matter and a truth that can be hidden."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_daemon.errors import BadInput
from edge_daemon.rig.drive_truth import DRIVE_TRUTHS, TORQUE_CONSTANT_Nm_per_A
from edge_daemon.rig.recording import (
    EDITION_SEEDS,
    EDITIONS,
    HIDDEN_CASES,
    Simulated,
    UnknownEffect,
    hidden,
    simulate,
)
from edge_daemon.rig.secret import SealError, reveal, seal, write
from edge_daemon.rig.truths import DRAWN_OUTSIDE, TRUTHS

SHORT_S = 6.0


def torque_gap(recording: Simulated) -> float:
    """RMS of J*alpha - K*phi - B*dphi relative to that of J*alpha, from exact columns."""
    p = recording.truth["parameters"]
    assert isinstance(p, dict)
    phi = recording.columns["theta_in_rad"] / p["ratio"] - recording.columns["theta_out_rad"]
    rate = float(str(recording.truth["rate_hz"]))
    alpha = np.diff(recording.columns["theta_out_rad"], 2) * rate**2
    torque = p["inertia_kg_m2"] * alpha
    dphi = (phi[2:] - phi[:-2]) * rate / 2
    gap = torque - p["stiffness_Nm_per_rad"] * phi[1:-1] - p["damping_Nms_per_rad"] * dphi
    return float(np.sqrt(np.mean(gap**2) / np.mean(torque**2)))


def exact(effect: str, seed: int = 11) -> Simulated:
    effects = (effect,) if effect else ()
    return simulate(effects, SHORT_S, seed=seed, rate_hz=4000.0, bits_in=0, bits_out=0)


def test_without_effects_only_spring_and_damper_remain() -> None:
    assert torque_gap(exact("")) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("effect", TRUTHS)
def test_every_effect_changes_the_torque_materially(effect: str) -> None:
    assert 0.04 < torque_gap(exact(effect)) < 1.0


def test_the_same_seed_gives_the_same_recording_and_another_seed_another() -> None:
    first, again, other = (simulate(("kinematic_error",), 2.0, seed=s) for s in (4, 4, 5))
    assert first.truth == again.truth
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, again.columns[name])
    assert not np.array_equal(first.columns["theta_out_rad"], other.columns["theta_out_rad"])


@pytest.mark.parametrize(("bits", "noise_free"), [(20, 2.0), (24, 2.0)])
def test_encoders_round_to_their_step(bits: int, noise_free: float) -> None:
    step = 2 * np.pi / 2**bits
    seen = simulate((), 2.0, seed=3, bits_out=bits).columns["theta_out_rad"]
    true = simulate((), 2.0, seed=3, bits_in=0, bits_out=0).columns["theta_out_rad"]
    np.testing.assert_allclose(seen / step, np.rint(seen / step), atol=1e-6)
    expected_sd = step * np.sqrt(1 / 12 + 0.25**2)
    assert np.std(seen - true) == pytest.approx(expected_sd, rel=0.05)


def test_positive_skew_reads_the_output_too_late() -> None:
    delay = 2e-4
    given = {"encoder_skew.delay_s": delay}
    late = simulate(("encoder_skew",), 2.0, seed=6, bits_in=0, bits_out=0, parameters=given)
    drawn = late.truth["parameters"]
    assert isinstance(drawn, dict)
    base = {name: drawn[name] for name in ("inertia_kg_m2", "stiffness_Nm_per_rad", "damping_Nms_per_rad")}
    fine = simulate((), 2.0, seed=6, rate_hz=4000.0, bits_in=0, bits_out=0, parameters=base)
    expected = np.interp(late.time_s + delay, fine.time_s, fine.columns["theta_out_rad"])
    error = late.columns["theta_out_rad"][:-2] - expected[:-2]
    travelled = np.abs(np.diff(fine.columns["theta_out_rad"])).max()
    assert np.abs(error).max() < 0.02 * travelled


def test_chosen_values_appear_and_unknown_ones_are_refused() -> None:
    made = simulate(("coulomb_friction",), 1.0, parameters={"coulomb_friction.level_Nm": 1.25, "inertia_kg_m2": 0.07})
    assert made.truth["parameters"]["coulomb_friction.level_Nm"] == 1.25  # type: ignore[index]
    assert made.truth["parameters"]["inertia_kg_m2"] == 0.07  # type: ignore[index]
    with pytest.raises(BadInput, match=r"coulomb_friction\.lvel"):
        simulate(("coulomb_friction",), 1.0, parameters={"coulomb_friction.lvel": 1.0})
    with pytest.raises(UnknownEffect, match="'magic'"):
        simulate(("magic",), 1.0)
    with pytest.raises(BadInput, match="rate_hz"):
        simulate((), 1.0, rate_hz=900.0)


def test_temperature_rises_only_where_an_effect_needs_it_or_one_asks() -> None:
    assert np.ptp(simulate((), 2.0).columns["temperature_degC"]) == 0.0
    assert np.ptp(simulate(("temperature_stiffness",), 30.0).columns["temperature_degC"]) > 10.0
    ramp = simulate((), 5.0, temperature=(10.0, 60.0)).columns["temperature_degC"]
    assert ramp[0] == 10.0
    assert np.all(np.diff(ramp) >= 0)


def test_hidden_recordings_look_alike_and_differ_in_what_they_hide() -> None:
    made = [hidden(seed, 1.0) for seed in range(30)]
    assert {tuple(recording.columns) for recording in made} == {("theta_in_rad", "theta_out_rad", "temperature_degC")}
    assert len({tuple(recording.truth["effects"]) for recording in made}) > 10  # type: ignore[arg-type]
    assert hidden(3, 1.0).truth == made[3].truth


HIDDEN_FOR_EVER = {
    0: ("encoder_skew",),
    1: ("bouc_wen_hysteresis",),
    2: ("piecewise_stiffness",),
    3: ("mesh_stiffness",),
    5: ("load_dependent_friction",),
    7: ("temperature_stiffness",),
    11: ("gravity_load", "coulomb_friction"),
    27: ("kinematic_error", "coulomb_friction"),
    2026: ("outside_twist_times_angle",),
    12345: ("coulomb_friction",),
}


@pytest.mark.parametrize(("seed", "effects"), HIDDEN_FOR_EVER.items())
def test_a_seed_hides_the_same_in_every_version(seed: int, effects: tuple[str, ...]) -> None:
    assert tuple(hidden(seed, 0.1).truth["effects"]) == effects  # type: ignore[arg-type]


def test_the_seed_of_the_readme_draws_the_same_gear_in_every_version() -> None:
    drawn = hidden(27).truth["parameters"]
    assert isinstance(drawn, dict)
    told = {"inertia_kg_m2": 0.188469, "stiffness_Nm_per_rad": 27957.3, "damping_Nms_per_rad": 6.5793}
    told |= {"kinematic_error.order2_rad": 0.000101232, "coulomb_friction.level_Nm": 3.11182}
    assert {name: drawn[name] for name in told} == pytest.approx(told, rel=1e-5)


def test_editions_only_grow_and_a_seed_of_none_is_refused() -> None:
    assert EDITIONS[0] == 26
    assert list(EDITIONS) == sorted(EDITIONS)
    assert EDITIONS[-1] == len(HIDDEN_CASES) == len(set(HIDDEN_CASES))
    for seed in (-1, len(EDITIONS) * EDITION_SEEDS):
        with pytest.raises(BadInput, match="seed"):
            hidden(seed, 0.1)


def test_what_is_outside_every_catalogue_is_drawn_as_ever() -> None:
    last = [list(simulate(("outside",), 0.1, seed=seed).truth["parameters"])[-1] for seed in range(4)]  # type: ignore[call-overload]
    wave, twist, vibration = DRAWN_OUTSIDE
    assert [name.split(".")[0] for name in last] == [wave, twist, vibration, vibration]


@pytest.mark.parametrize("name", ["practice.csv", "practice.parquet"])
def test_a_seal_says_nothing_to_the_eye_and_everything_to_reveal(tmp_path: Path, name: str) -> None:
    recording, file = hidden(8, 1.0), tmp_path / name
    write(recording, file)
    sealed = seal(file, recording.truth)
    for word in ("kinematic", "friction", "effects", "stiffness"):
        assert word not in sealed.read_text()
        assert word.encode() not in file.read_bytes()
    assert reveal(file) == recording.truth


def test_a_seal_that_is_missing_broken_or_of_another_recording_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "r.csv"
    write(hidden(8, 1.0), file)
    with pytest.raises(SealError, match="cannot read"):
        reveal(file)
    sealed = seal(file, {"effects": []})
    file.write_text(file.read_text() + "1,2,3,4\n")
    with pytest.raises(SealError, match="changed"):
        reveal(file)
    sealed.write_text("nonsense")
    with pytest.raises(SealError, match="not a seal"):
        reveal(file)


def test_a_written_recording_keeps_the_encoders_last_step(tmp_path: Path) -> None:
    recording, file = simulate((), 1.0, seed=2), tmp_path / "r.csv"
    write(recording, file)
    table = np.genfromtxt(file, delimiter=",", names=True)
    for name, column in recording.columns.items():
        np.testing.assert_allclose(table[name], column, atol=1e-10)


@pytest.mark.parametrize("effect", DRIVE_TRUTHS)
def test_each_drive_effect_adds_to_the_current_of_the_inertia(effect: str) -> None:
    recording = simulate((effect,), SHORT_S, seed=9, balance="drive", bits_out=0)
    p = recording.truth["parameters"]
    assert isinstance(p, dict)
    torque = recording.columns["current_in_A"] * TORQUE_CONSTANT_Nm_per_A * p["ratio"]
    alpha = np.gradient(recording.columns["velocity_out_rad_s"], 1e-3)
    rest = torque - p["inertia_kg_m2"] * alpha
    assert 0.05 < np.sqrt(np.mean(rest**2) / np.mean(torque**2)) < 1.5


def test_coulomb_in_the_drive_balance_is_the_level_with_the_sign_of_the_speed() -> None:
    given = {"coulomb_friction.level_Nm": 5.0}
    recording = simulate(("coulomb_friction",), SHORT_S, seed=9, balance="drive", parameters=given)
    p = recording.truth["parameters"]
    assert isinstance(p, dict)
    torque = recording.columns["torque_in_Nm"] * p["ratio"]
    speed = recording.columns["velocity_out_rad_s"]
    rest = torque - p["inertia_kg_m2"] * np.gradient(speed, 1e-3)
    for side in (1, -1):
        assert rest[side * speed > 0.1].mean() == pytest.approx(5.0 * side, rel=0.02)


def test_an_unknown_drive_effect_is_refused() -> None:
    with pytest.raises(UnknownEffect, match="backlash"):
        simulate(("backlash",), 1.0, balance="drive")

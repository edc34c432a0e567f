"""What every effect promises, checked over the whole table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.effects.catalogue import CATALOGUE, find, shape_of
from edge_daemon.effects.effect import Effect, twin
from edge_daemon.effects.model import FittedParameter, Model, ModelEffect, ModelError
from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import Motion

TORSION = """linear_stiffness viscous_damping polynomial_stiffness piecewise_stiffness coulomb_friction
stribeck_friction lugre_friction dahl_friction load_dependent_friction bouc_wen_hysteresis
maxwell_slip_hysteresis asymmetric_hysteresis backlash kinematic_error torque_ripple mesh_stiffness gravity_load
constant_load inertia_error output_viscous_friction output_coulomb_friction encoder_eccentricity encoder_skew
temperature_stiffness temperature_friction motor_side"""
DRIVE = """inertia joint_elasticity model_torque constant_torque viscous_friction coulomb_friction asymmetric_friction
stribeck_friction sublinear_friction superlinear_friction load_dependent_friction squared_load_friction
two_sided_load_friction creep_load_friction gravity_load constant_load wave_generator_ripple load_ripple
speed_ripple kinematic_error temperature_friction hysteresis dahl_friction maxwell_slip_hysteresis
lugre_friction varying_inertia"""

EVERY = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=[f"{b}-{n}" for b, n in CATALOGUE])


def motion(n: int = 400, seed: int = 7) -> Motion:
    """A smooth random motion of the size that a gear has."""
    t = np.arange(n) / 1000.0
    rng = np.random.default_rng(seed)

    def wave(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        w, p = 2 * np.pi * rng.uniform(1, 12, 3), rng.uniform(0, 6, 3)
        return tuple(
            size * sum(f(w[i] * t + p[i]) * w[i] ** k for i in range(3))
            for k, f in enumerate((np.sin, np.cos, lambda x: -np.sin(x)))
        )  # type: ignore[return-value]

    phi, rate, _ = wave(1e-4)
    out, speed, acceleration = wave(0.2)
    return Motion(
        1000.0,
        100.0,
        t,
        100 * (out + phi),
        out,
        phi,
        rate,
        speed,
        acceleration,
        0.1 * acceleration,
        25 + 10 * t,
        {"torque_out_Nm": 0.1 * acceleration, "current_in_A": acceleration, "torque_model_Nm": out},
        out,
        out + speed,
        acceleration - out,
    )


def corners(effect: Effect) -> list[dict[str, float]]:
    """Start, all lower and all upper bounds."""
    return [effect.start, {p.name: p.lower for p in effect.shapes}, {p.name: p.upper for p in effect.shapes}]


def test_names_are_those_promised() -> None:
    assert {n for b, n in CATALOGUE if b == "torsion"} == set(TORSION.split())
    assert {n for b, n in CATALOGUE if b == "drive"} == set(DRIVE.split())


@EVERY
def test_declares_itself(effect: Effect) -> None:
    assert effect.meaning and effect.equation and effect.source and effect.amplitudes
    names = [p.name for p in (*effect.amplitudes, *effect.shapes)]
    assert len(names) == len(set(names))
    for p in (*effect.amplitudes, *effect.shapes):
        assert p.unit and p.meaning and p.lower < p.upper and p.lower <= p.start <= p.upper, p
    assert set(effect.tied) <= {p.name for p in effect.shapes}
    for owner, parameter in effect.tied.values():
        assert parameter in [p.name for p in find(owner, effect.balance).amplitudes]
    assert all((effect.balance, simpler) in CATALOGUE for simpler in effect.refines)


@EVERY
def test_twins_and_what_comes_first_are_known_rows(effect: Effect) -> None:
    """A fact of two rows is stated in one of them, and a row comes after what is more usual, not the reverse."""
    for fact in effect.twins:
        other = find(fact.name, effect.balance)
        assert other is not effect and effect.name not in [row.name for row in other.twins]
        assert twin(effect, other) is twin(other, effect) is fact
    for name in effect.yields_to:
        assert effect.name not in find(name, effect.balance).yields_to


@EVERY
def test_what_a_column_follows_is_that_field(effect: Effect) -> None:
    block = motion()
    columns, _ = effect.columns(block, effect.start, None)
    if effect.follows:
        np.testing.assert_array_equal(columns, getattr(block, effect.follows)[:, None])


@EVERY
def test_a_spring_is_what_depends_on_the_twist_alone(effect: Effect) -> None:
    """Samples in another order, with another motion beside each twist, give the same torques in that order."""
    block, order = motion(), np.random.default_rng(3).permutation(400)
    other = replace(motion(seed=8), twist_rad=block.twist_rad[order])
    here, there = (effect.columns(row, effect.start, None)[0] for row in (block, other))
    assert effect.is_spring == (np.allclose(there, here[order], rtol=1e-12, atol=0.0) and bool(np.ptp(here)))


@EVERY
def test_what_is_steady_can_be_a_constant(effect: Effect) -> None:
    block = motion()
    still = replace(block, theta_out_rad=1.0 + 0.01 * block.theta_out_rad)
    left = {}
    for name, row in {"exactly": block, "nearly": still}.items():
        columns, ones = effect.columns(row, effect.start, None)[0], np.ones(len(row))
        left[name] = np.std(ones - columns @ np.linalg.lstsq(columns, ones, rcond=None)[0])
    assert (effect.steady == "exactly") == (left["exactly"] < 1e-9)
    assert left.get(effect.steady, 0.0) < 0.01


@EVERY
def test_what_tells_an_effect_goes_with_what_it_is(effect: Effect) -> None:
    assert effect.is_angle_error == (effect.kind == "measurement")
    if effect.balance == "torsion":
        assert effect.is_angle_error == (effect.told_by in ("angle", "timing"))
        assert effect.is_spring == (effect.told_by in ("stiffness", "corners"))


@EVERY
def test_what_is_read_is_needed(effect: Effect) -> None:
    """Without the channels that the row does not name, the columns are what they are with them."""
    block = motion()
    named = {name: column for name, column in block.extra.items() if name in effect.needs}
    degc = block.temperature_degC if "temperature_degC" in effect.needs else np.full(len(block), np.nan)
    columns, _ = effect.columns(replace(block, temperature_degC=degc, extra=named), effect.start, None)
    assert np.isfinite(columns).all()


@EVERY
def test_what_is_tracked_live_is_a_quantity_of_that_unit(effect: Effect) -> None:
    for row in effect.shapes:
        assert not row.quantity or QUANTITIES[row.quantity].unit == row.unit
    assert not effect.state_quantity or QUANTITIES[effect.state_quantity].unit == "1"


@EVERY
def test_one_finite_column_per_amplitude(effect: Effect) -> None:
    block = motion()
    for shape in corners(effect):
        columns, _ = effect.columns(block, shape, None)
        assert columns.shape == (len(block), len(effect.amplitudes))
        assert np.isfinite(columns).all()
        assert not (columns @ np.zeros(columns.shape[1])).any()


@EVERY
def test_block_boundaries_leave_no_trace(effect: Effect) -> None:
    block = motion()
    whole, end = effect.columns(block, effect.start, None)
    first, state = effect.columns(block.between(0, 137), effect.start, None)
    second, last = effect.columns(block.between(137, None), effect.start, state)
    joined = np.vstack((first, second))
    # a derivative is of lower order three samples on either side of a cut
    reach = 3 * (effect.name == "encoder_skew")
    exact = np.r_[0 : 137 - reach, 137 + reach : len(block) - reach]
    np.testing.assert_allclose(joined[exact], whole[exact], rtol=1e-9, atol=1e-12)
    assert (end is None) == (last is None)


@EVERY
def test_block_is_not_written_to(effect: Effect) -> None:
    block, same = motion(), motion()
    effect.columns(block, effect.start, None)
    for name in ("twist_rad", "theta_in_rad", "velocity_out_rad_s", "torque_Nm"):
        np.testing.assert_array_equal(getattr(block, name), getattr(same, name))


def test_unknown_name_suggests_the_closest() -> None:
    with pytest.raises(ModelError, match="did you mean 'coulomb_friction'"):
        find("coulomb_fricton", "torsion")


def test_tied_shape_follows_the_model() -> None:
    fitted = ModelEffect("linear_stiffness", {"stiffness": FittedParameter(31000.0)})
    model = Model("torsion", 100.0, 0.1, (fitted, ModelEffect("kinematic_error")))
    assert shape_of(model, find("kinematic_error", "torsion")) == {"stiffness": 31000.0, "damping": 5.0}


def test_stop_and_bouc_wen_agree_with_small_steps() -> None:
    """Both against their differential equations, integrated by Euler steps a thousand times finer."""
    t = np.linspace(0, 1, 201)
    x = 3e-4 * np.sin(9 * t) + 1e-4 * np.sin(31 * t)
    block = replace(motion().between(0, 201), twist_rad=x)
    width, rounding = 1e-4, 0.7
    fine = np.interp(np.linspace(0, 1, 200_001), t, x)
    slip, bend, kept = 0.0, 0.0, [(0.0, 0.0)]
    for k, step in enumerate((np.diff(fine) / width).tolist(), start=1):
        slip = min(max(slip + step, -1.0), 1.0)
        bend += step - rounding * abs(step) * bend - (1 - rounding) * step * abs(bend)
        if k % 1000 == 0:
            kept.append((slip, bend))
    truth = np.array(kept)
    widths = [row.name for row in find("maxwell_slip_hysteresis", "torsion").shapes]
    maxwell, _ = find("maxwell_slip_hysteresis", "torsion").columns(block, dict.fromkeys(widths, width), None)
    bouc, _ = find("bouc_wen_hysteresis", "torsion").columns(block, {"width": width, "rounding": rounding}, None)
    np.testing.assert_allclose(maxwell[:, 0], truth[:, 0], atol=1e-9)
    np.testing.assert_allclose(bouc[:, 0], truth[:, 1], atol=2e-3)


def test_an_asymmetric_loop_holds_more_on_one_side() -> None:
    """After a full turn of the loop it stands at the limit of either end; widths and taper say how much that is."""
    x = 1e-4 * np.sin(2 * np.pi * np.arange(401) / 200)
    block, row = replace(motion(401), twist_rad=x), find("asymmetric_hysteresis", "torsion")
    shape = {**{f"width_{i}": 2e-4 / 2**i for i in range(1, 7)}, "asymmetry": 1.5}
    z, _ = row.columns(block, shape, None)
    np.testing.assert_allclose(z[250, 1:], 1.2, rtol=1e-9)  # (1.5 - 1) / (1.5 + 1), and w_1 is the twist's height
    np.testing.assert_allclose(z[350, 1:], -0.8, rtol=1e-9)
    even, _ = row.columns(block, {**shape, "asymmetry": 1.0}, None)
    widths = {name: width for name, width in shape.items() if name != "asymmetry"}
    np.testing.assert_array_equal(even, find("maxwell_slip_hysteresis", "torsion").columns(block, widths, None)[0])


def test_lugre_slides_at_the_coulomb_level() -> None:
    n = 400
    block = replace(motion(n), twist_rad=np.arange(n) * 1e-5, twist_rate_rad_s=np.full(n, 1e-2))
    shape = {"presliding": 1e-5, "static_ratio": 1.5, "stribeck_speed": 1e-3}
    z, _ = find("lugre_friction", "torsion").columns(block, shape, None)
    assert z[0, 0] == 0
    assert z[-1, 0] == pytest.approx(1.0, rel=1e-6)
    assert z[0, 1] == pytest.approx(1e-2), "bristles that stand upright bend as fast as the gear twists"
    assert abs(z[-1, 1]) < 1e-8, "and no further where they slide"


def test_kinematic_error_is_the_torque_of_an_angle() -> None:
    """K e + B de/dt with the motor speed differentiated numerically."""
    block = motion()
    e = 1e-5 * np.sin(2 * block.theta_in_rad)
    columns, _ = find("kinematic_error", "torsion").columns(block, {"stiffness": 3e4, "damping": 6.0}, None)
    names = [p.name for p in find("kinematic_error", "torsion").amplitudes]
    w = np.gradient(block.theta_in_rad, block.time_s)
    expected = 3e4 * e + 6.0 * 1e-5 * 2 * w * np.cos(2 * block.theta_in_rad)
    got = 1e-5 * columns[:, names.index("sine_2")]
    np.testing.assert_allclose(got[2:-2], expected[2:-2], atol=2e-3 * np.abs(expected).max())

"""What a law may depend on: channels as they are, as they were, and the clock."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.factors import KINDS, Factor, Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.memory import begun_before
from edge_daemon.discover.past_axes import LAGS, channel_of, differences, row_of
from edge_daemon.discover.proposals import proposals
from edge_daemon.discover.refining import fitted
from edge_daemon.discover.screening import Library, Screening
from edge_daemon.discover.search import retells
from edge_daemon.discover.writing import related
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.records import Array
from edge_daemon.rig.recording import simulate
from tests.discover.laws import DRIVEN, SECONDS, beside_a_sensor, ignored, joined_to_a_sensor, left_by, pressure_bar
from tests.explain.test_torque_sensor import MODEL as SENSED
from tests.explain.test_torque_sensor import joint as sensed

pytestmark = pytest.mark.slow


def test_what_parts_of_a_joint_differ_by_is_an_axis() -> None:
    assert differences(["temperature_motor_degC", "pressure_bar", "temperature_degC"]) == [
        "(temperature_motor_degC - temperature_degC)"
    ]
    read = simulate(seconds=SECONDS, seed=3, bits_out=24, balance="drive")
    torque, speed, share = read.columns["torque_in_Nm"], read.columns["velocity_out_rad_s"], read.time_s / SECONDS
    warm, housing = 25.0 + 20.0 * share, 25.0 + 12.0 * share**2
    squeezed = np.sign(speed) * np.maximum(warm - housing - 4.0, 0.0)
    columns = {"theta_out_rad": read.columns["theta_out_rad"], "temperature_degC": housing}
    columns |= {"temperature_motor_degC": warm, "torque_in_Nm": torque + 0.05 * torque.std() * squeezed}
    model = Model("drive", 100.0, np.nan, (ModelEffect("inertia"),))
    best = proposals([SimpleNamespace(time_s=read.time_s, columns=columns)], model, ignored)[0]
    assert "maximum((temperature_motor_degC - temperature_degC) - 4, 0)" in best.expression
    assert "temperature_motor_degC less temperature_degC" in best.reads


def test_a_channel_as_it_is_comes_before_what_follows_it(magnet: Leftover) -> None:
    late = Factor(KINDS["saturation"], "lag(time_s, velocity_out_rad_s, 0.1)", (0.5,))
    assert [kin.axis for kin in related(late)] == ["velocity_out_rad_s"]


def test_what_comes_late_is_followed_with_its_time() -> None:
    recording = simulate(seconds=SECONDS, seed=3, bits_out=24, laws=(DRIVEN["late_drag"],), balance="drive")
    known: dict[str, float] = recording.truth["parameters"]  # type: ignore[assignment]
    best = proposals([recording], Model("drive", 100.0, np.nan, (ModelEffect("inertia"),)), ignored)[0]
    axis = next(iter(best.range))
    assert "what follows the output speed" in best.reads and "from the beginning" in best.reads
    assert best.probability > 0.9
    row = row_of(axis)
    assert row is not None and row.time_of(axis) == pytest.approx(known["late_drag.after"], rel=0.1)


def test_what_was_before_a_recording_is_a_guess_where_a_law_remembers_long(magnet: Leftover) -> None:
    def guessed(kind: str, axis: str, *numbers: float) -> bool:
        formula = fitted(magnet, [Product((Factor(KINDS[kind], axis, numbers),))])
        assert formula is not None
        return begun_before(magnet, formula)

    warm, late = LAGS["lag(time_s, velocity_out_rad_s**2, 4)"], LAGS["lag(time_s, velocity_out_rad_s, 0.1)"]
    assert guessed("exponential", warm.at(4.0), 0.1) and not guessed("power_1", warm.at(4.0))
    assert not guessed("saturation", late.at(0.1), 0.1) and not guessed("exponential", "time_s", 0.1)


def test_a_pressure_that_acts_later_than_it_is_read_is_told_with_its_delay() -> None:
    """A seal that a pressure presses on, 0.42 s after the sensor tells it."""
    recording = beside_a_sensor(lambda time_s, speed: 0.5 * pressure_bar(time_s - 0.42) * np.tanh(speed / 0.01))
    best = proposals([recording], joined_to_a_sensor(), ignored)[0]
    (axis,) = [axis for axis in best.range if channel_of(axis) == "pressure_bar"]
    row = row_of(axis)
    assert row is not None and row.text.startswith("delay") and row.time_of(axis) == pytest.approx(0.42, rel=0.05)
    assert "pressure_bar as it was" in best.reads


def test_a_level_of_what_comes_late_is_told_as_such() -> None:
    """Waves of the clock imitated it: they were found first, and only in their place it was asked what comes late."""
    recording = beside_a_sensor(
        lambda time_s, speed: 3.0 * np.maximum(pressure_bar(time_s - 0.7) - 2.1, 0.0) * np.tanh(speed / 0.01)
    )
    best = proposals([recording], joined_to_a_sensor(), ignored)[0]
    limits = re.findall(r"maximum\(delay\(time_s, pressure_bar, ([.\d]+)\) - ([.\d]+), 0\)", best.expression)
    assert limits and tuple(map(float, limits[0])) == pytest.approx((0.7, 2.1), rel=0.05)


def test_a_formula_of_several_events_of_the_clock_is_none() -> None:
    """A torque of other joints was retold as what happened at 3.7 s and at 7.9 s, and left 71 % three seconds later."""
    early, late = (Factor(KINDS["step"], "time_s", (at_s, 0.8)) for at_s in (3.7, 7.9))
    place = Factor(KINDS["step"], "theta_out_rad", (0.3, 0.1))
    once, twice = Product((early, place)), Product((early, late))
    refused = [(twice,), (Product((early,)), Product((late,)))]
    assert all(retells(products, balance) for products in refused for balance in ("torsion", "drive"))
    assert not any(retells(products, "drive") for products in ((once,), (once, Product((early,)))))


def test_a_temperature_that_only_rises_tells_the_time() -> None:
    """A payload that was carried for a third of a recording was retold by two bumps of the housing's temperature."""
    rng = np.random.default_rng(3)
    model = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("viscous_friction")))

    def left(degC: np.ndarray) -> Leftover:
        time_s = np.arange(5000) / 250.0
        angle = np.sin(1.3 * time_s) + 0.2 * np.sin(7.1 * time_s)
        columns = {"theta_out_rad": angle + rng.normal(0, 1e-6, 5000), "torque_in_Nm": np.cos(2.0 * time_s)}
        recording = SimpleNamespace(time_s=time_s, columns=columns | {"temperature_degC": np.round(degC, 1)})
        problem = problem_of([recording], model)
        return Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)

    rising = left(27.0 + 3.0 * np.linspace(0, 1, 5000) ** 0.5 + rng.normal(0, 0.05, 5000))
    swinging = left(27.0 + 2.0 * np.sin(np.linspace(0, 9, 5000)))
    picked, put = (Product((Factor(KINDS["bump"], "temperature_degC", (at, 0.4)),)) for at in (28.4, 29.0))
    for products, refused in (((picked, put), True), ((picked,), False)):
        assert retells(products, "drive", rising.clocks) is refused
        assert not retells(products, "drive", swinging.clocks)


def test_several_waves_of_the_clock_or_one_that_moves_are_no_law_of_a_joint() -> None:
    """The coupling of joints that followed a periodic course was retold by two, and called adequate; half of it was
    left seven seconds later."""
    hum, other = (Factor(KINDS["sine"], "time_s", (rad_s,)) for rad_s in (2.7, 4.5))
    drag, fades = Factor(KINDS["power_1"], "velocity_out_rad_s"), Factor(KINDS["exponential"], "time_s", (-0.2,))
    refused = [(Product((hum,)), Product((other,))), (Product((hum, drag)),)]
    assert all(retells(products, "drive") and not retells(products, "torsion") for products in refused)
    assert not any(retells(products, "drive") for products in ((Product((hum, fades)),), (Product((drag, fades)),)))


def test_no_tone_above_half_the_sampling_rate_is_offered() -> None:
    """At 50 Hz one of 49.57 Hz is that of 0.43 Hz, and was written for it."""
    recording = simulate(seconds=SECONDS, seed=3, bits_out=24, rate_hz=50.0, balance="drive")
    model = Model("drive", 100.0, np.nan, (ModelEffect("inertia"),))
    problem = problem_of([recording], model)
    leftover = Leftover(problem, fit_terms(problem, terms_of(model, problem)), model)
    tones = Screening(Library(leftover), np.sin(2 * np.pi * 0.43 * leftover.rows["time_s"])).sines()
    factors = [factor for row in tones for factor in row.product.factors]
    orders = [factor.numbers[0] for factor in factors if factor.kind.name == "sine" and factor.axis == "time_s"]
    assert orders and max(orders) < np.pi * 50.0
    assert min(abs(order - 2 * np.pi * 0.43) for order in orders) < 0.1


def test_a_torque_under_another_name_is_no_axis() -> None:
    """A commanded torque beside the measured one left nothing, and was sure of it. A twist is like it, and is one."""
    read = sensed(2, 20)
    torque = read.columns["torque_out_Nm"]
    read.columns |= {"demand": 1.02 * torque + 0.1, "valve": np.sin(0.3 * read.time_s)}
    names = set(left_by(read, SENSED).names)
    assert {"valve", "twist_rad"} <= names and "demand" not in names


def test_acceleration_is_an_axis_where_others_load_the_joint() -> None:
    """A disc between gear and sensor that friction carries along. Of a load of its own, acceleration is the torque."""

    def slipping(time_s: Array, speed: Array) -> Array:
        return 0.2 * np.tanh(np.gradient(speed, time_s) / 3.0)

    read = beside_a_sensor(slipping, swing_rad=0.15)
    best = proposals([read], joined_to_a_sensor(), ignored)[0]
    assert re.fullmatch(r"a\*tanh\(acceleration_out_rad_s2/(\S+)\)", best.expression) and best.probability > 0.9
    assert best.parameters["a"] == pytest.approx(0.2, rel=0.05)
    assert "acceleration_out_rad_s2" not in left_by(sensed(2, 20), SENSED).names

"""Laws that show only beside a constant: the zero of a sensor hides them, or they are a constant less something."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.discover.factors import KINDS, Factor, Product
from edge_daemon.discover.leftover import Leftover
from edge_daemon.discover.proposals import proposals
from edge_daemon.discover.refining import settled
from edge_daemon.discover.writing import with_constant
from edge_daemon.effects.expression import evaluate, parse
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.records import Array

RATE_HZ, SECONDS = 200.0, 40.0
STIFFNESS, DAMPING, FADES, ZERO_NM = 2e4, 20.0, -60.0, 0.6
STACK_NM, SOFT_RAD = 15.0, 3.2


def smooth(rng: np.random.Generator, highest_hz: float) -> Array:
    """(n,) a motion of many tones, of one unit."""
    shape = np.fft.rfft(rng.normal(size=round(SECONDS * RATE_HZ)))
    shape[np.fft.rfftfreq(round(SECONDS * RATE_HZ), 1 / RATE_HZ) > highest_hz] = 0.0
    course = np.fft.irfft(shape, round(SECONDS * RATE_HZ))
    return np.asarray(course / course.std())


def fading(seed: int) -> SimpleNamespace:
    """A gear whose stiffness falls by 0.3 % a second, its torque read by a sensor with a zero of its own."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    twist, angle = 6e-4 * smooth(rng, 3.0), 0.4 * smooth(rng, 0.5)
    torque = (STIFFNESS + FADES * time_s) * twist + DAMPING * np.gradient(twist, time_s) + ZERO_NM
    noise = rng.normal(size=(3, len(time_s)))
    columns = {
        "theta_in_rad": 100.0 * (angle + twist) + 2e-5 * noise[0],
        "theta_out_rad": angle + 2e-7 * noise[1],
        "torque_out_Nm": torque + 0.02 * noise[2],
    }
    return SimpleNamespace(time_s=time_s, columns=columns)


def valve(seed: int) -> SimpleNamespace:
    """A valve's spindle against a stack of springs that give way more and more: 15 N m less an exponential."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    angle = 4.0 + 1.7 * np.clip(smooth(rng, 0.3), -2.2, 2.2)
    angle = np.convolve(np.pad(angle, 100, mode="edge"), np.hanning(201) / np.hanning(201).sum(), mode="valid")
    speed = np.gradient(angle, time_s)
    torque = 0.9 * np.gradient(speed, time_s) + 2.0 * speed + 3.0 * np.tanh(speed / 1e-3)
    torque += STACK_NM * (1 - np.exp(-angle / SOFT_RAD))
    columns = {"theta_out_rad": angle + 1e-5 * rng.normal(size=len(angle)), "torque_in_Nm": torque / 50.0}
    columns["torque_in_Nm"] += 5e-4 * rng.normal(size=len(angle))
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_zero_of_the_torque_sensor_hides_no_stiffness_that_fades(seed: int) -> None:
    """The zero was told as the size of an angle that is full from half a microradian."""
    model = Model("torsion", 100.0, math.nan, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
    first = proposals([fading(seed)], model, lambda what, share: None)[0]
    assert first.expression.split(" + ") == ["a*twist_rad*time_s", "b"]
    assert first.parameters["a"] == pytest.approx(FADES, rel=0.05)
    assert first.parameters["b"] == pytest.approx(ZERO_NM, rel=0.05)
    assert "a constant of 0.6" in first.reads


def test_an_axis_that_is_made_on_the_way_is_there_without_the_constant(healthy: Leftover) -> None:
    """A drag that fades with what was before ended in a traceback."""
    axis = "lag(time_s, velocity_out_rad_s**2, 5.03)"
    fresh = Leftover(healthy.problem, healthy.base, healthy.model)
    beside = fresh.beside_a_constant()
    assert axis not in fresh.spans
    beside.make(axis)
    found = settled(beside, [Product((Factor(KINDS["saturation"], axis, (1.0,)),))])
    assert found is not None
    with_constant(beside, found, 1e-3)
    assert fresh.spans[axis].width > 0.0


@pytest.mark.parametrize("seed", [1, 2])
def test_a_constant_less_an_exponential_is_one_law(seed: int) -> None:
    """It was told as the angle times an exponential beside the angle, or as two frictions, which leave as little."""
    names = "inertia", "viscous_friction", "coulomb_friction"
    model = Model("drive", 50.0, math.nan, tuple(map(ModelEffect, names)))
    first = proposals([valve(seed)], model, lambda what, share: None)[0]
    angle = np.linspace(1.5, 7.0, 50)
    parsed = parse(first.expression, {"theta_out_rad"})
    told = evaluate(parsed.tree, {"theta_out_rad": angle, **first.parameters})
    true = STACK_NM * (1 - np.exp(-angle / SOFT_RAD)) / 50.0
    assert np.abs(told - true).max() < 0.02 * STACK_NM / 50.0
    assert len(parsed.amplitudes) == 2

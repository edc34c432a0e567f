"""What a first look at a drive says of its inertia, which decides what its encoder's noise is weighed against."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from tests.explain.simulated_drives import Joint

INERTIA, VISCOUS, COULOMB, SPRING, NOISE = 0.225, 0.333, 0.46, 0.0458, 0.023
RATIO = 100.0


def reel(seed: int) -> Joint:
    """A reel that is wound against springs whose torque is the square of the angle: moves and stops by smooth steps,
    13 bits per motor turn, stamps that err by 40 microseconds."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, 60.0, 1e-3)
    goals = np.repeat(rng.uniform(-1.0, 8.0, 15), 4000)
    kernel = np.hanning(3600) / np.hanning(3600).sum()
    angle = np.convolve(np.pad(goals, 3600, mode="edge"), kernel, mode="same")[3600:-3600]
    speed = np.gradient(angle, 1e-3)
    moving = np.tanh(speed / 1e-4)
    torque = INERTIA * np.gradient(speed, 1e-3) + VISCOUS * speed + COULOMB * moving + SPRING * angle**2
    time_s = np.arange(0.1, 59.8, 0.005) + rng.uniform(-5e-4, 5e-4, 11940)
    step = 2 * math.pi / 2**13 / RATIO
    read, current = (np.interp(time_s, fine, row) for row in (angle, torque))
    columns = {
        "theta_out_rad": np.rint(read / step) * step,
        "current_in_A": current + rng.normal(0, NOISE, len(time_s)),
    }
    return Joint(time_s + rng.normal(0, 4e-5, len(time_s)), columns)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_load_of_any_form_by_the_angle_hides_no_inertia(seed: int) -> None:
    """A weight was the only load that was looked for beside the inertia. Beside another that was not known, and no
    noise of the acceleration weighed: the true law left twelve noise floors, and a tenth of the inertia."""
    names = ("inertia", "viscous_friction", "coulomb_friction")
    own = ModelEffect("own", expression="a*theta_out_rad**2", unit="A")
    found = fit([reel(seed)], Model("drive", RATIO, math.nan, (*map(ModelEffect, names), own)))
    truth = {"inertia": INERTIA, "viscous_friction": VISCOUS, "coulomb_friction": COULOMB, "own": SPRING}
    for name, value in truth.items():
        assert float(found.solution.amplitudes[name][0]) == pytest.approx(value, rel=0.05)
    assert found.solution.rmse < 1.5 * found.floor


def press(seed: int) -> Joint:
    """A press whose crank turns one way at changing speeds, its ram an inertia that changes twice a turn; stamps are
    rounded to a tenth of a millisecond, and samples were taken 30 microseconds about them."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, 30.0, 2e-4)
    kernel = np.hanning(2000) / np.hanning(2000).sum()
    paces = np.repeat(rng.uniform(1.0, 5.0, 20), 7500)
    speed = np.convolve(np.pad(paces, 2000, mode="edge"), kernel, mode="same")[2000:-2000]
    angle = np.cumsum(speed) * 2e-4
    inertia, bend = INERTIA * (1 + 0.4 * np.cos(2 * angle)), -0.8 * INERTIA * np.sin(2 * angle)
    torque = inertia * np.gradient(speed, 2e-4) + bend * speed**2 / 2 + VISCOUS * speed + COULOMB
    read_s = np.arange(0.1, 29.8, 0.002) + rng.normal(0, 3e-5, 14850)
    read, current = (np.interp(read_s, fine, row) for row in (angle, torque))
    columns = {"theta_out_rad": read, "current_in_A": current + rng.normal(0, NOISE, len(read_s))}
    return Joint(np.round(read_s, 4), columns)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_shaft_that_turns_one_way_hides_no_inertia(seed: int) -> None:
    """There the sign of the speed is a constant: of two columns that are one no inertia was told, and no noise of the
    acceleration weighed."""
    names = ("inertia", "viscous_friction", "coulomb_friction", "varying_inertia")
    found = fit([press(seed)], Model("drive", RATIO, math.nan, tuple(map(ModelEffect, names))))
    assert float(found.solution.amplitudes["inertia"][0]) == pytest.approx(INERTIA, rel=0.05)
    varying = found.solution.amplitudes["varying_inertia"]
    assert varying == pytest.approx([0.0, 0.0, 0.0, 0.4 * INERTIA], abs=0.02 * INERTIA)
    assert found.solution.rmse < 1.5 * found.floor

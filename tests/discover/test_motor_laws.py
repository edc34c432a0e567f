"""What goes wrong in a motor goes with all that it makes, friction of the gear within; and what is no motor's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import savgol_filter

from edge_daemon.discover.discover import discover
from edge_daemon.discover.proposals import Rival, proposals
from edge_daemon.effects.expression import user_effect
from edge_daemon.effects.model import Model, ModelEffect, ModelError
from edge_daemon.identify.fit import fit
from tests.explain.test_torque_sensor import MODEL as SENSED
from tests.explain.test_torque_sensor import joint as sensed

pytestmark = pytest.mark.slow

RATIO, RATE_HZ, SECONDS, BITS, NOISE = 100.0, 250.0, 24.0, 22, 1e-3
INERTIA, WEIGHT_NM, DRAG, FRICTION_NM, WIDTH_RAD_S = 0.8, 6.0, 4.0, 3.0, 1e-3
MODEL = Model(
    "drive",
    RATIO,
    math.nan,
    tuple(map(ModelEffect, ("inertia", "gravity_load", "viscous_friction", "coulomb_friction"))),
)
Meter = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(torque that the motor makes, temperature of its winding) -> what is read of it, (n,) each"""


def saturating(torque: np.ndarray, winding: np.ndarray) -> np.ndarray:
    """Iron that saturates takes more current for each further newton metre."""
    return torque * (1 + 0.1 * (torque / 10.0) ** 2)


def weakened(torque: np.ndarray, winding: np.ndarray) -> np.ndarray:
    """Magnets lose their field as they warm."""
    return torque * (1 + 4e-3 * (winding - 25.0))


def joint(seed: int, meter: Meter, noise: float = NOISE) -> SimpleNamespace:
    """A weight on a joint that moves by four tones; the torque that its motor makes, as it is read."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    omega = 2 * math.pi * np.array([0.11, 0.29, 0.71, 1.7]) * rng.uniform(0.9, 1.1, 4)
    speed = np.array([0.5, 0.5, 0.4, 0.3]) * rng.uniform(0.8, 1.2, 4)
    waves = np.exp(1j * (np.outer(time_s, omega) + rng.uniform(0, 6.28, 4)))
    angle, rate, rise = ((waves * speed * (1j * omega) ** k).real.sum(axis=1) for k in (-1, 0, 1))
    winding = 25.0 + 20.0 * (1 - np.exp(-time_s / 10.0)) + 3.0 * np.sin(0.9 * time_s)
    torque = INERTIA * rise + WEIGHT_NM * np.sin(angle + 0.4) + DRAG * rate + FRICTION_NM * np.tanh(rate / WIDTH_RAD_S)
    read = meter(torque, winding) / RATIO
    step = 2 * math.pi / 2**BITS
    columns = {
        "theta_out_rad": np.rint(angle / step + rng.uniform(-0.5, 0.5, len(angle))) * step,
        "torque_in_Nm": read + noise * float(read.std()) * rng.normal(size=len(read)),
        "winding_degC": winding,
    }
    return SimpleNamespace(time_s=time_s, columns=columns)


@pytest.mark.parametrize(
    ("meter", "expression", "amplitude"),
    [(saturating, "a*motor_Nm**3", 1e-3 * RATIO**2), (weakened, "a*motor_Nm*winding_degC", 4e-3 / 0.9)],
)
def test_a_law_of_the_motor_is_told_by_one_number(meter: Meter, expression: str, amplitude: float) -> None:
    """Torques are those at the motor; one that is read as it is at 25 degC would be a tenth less at nought."""
    recording = joint(1, meter)
    best = proposals([recording], MODEL, lambda what, share: None)[0]
    assert sorted(best.expression.split("*")) == sorted(expression.split("*"))
    assert best.probability > 0.9
    law = ModelEffect("motor", expression=best.expression)
    found = fit([joint(2, meter)], Model(MODEL.balance, RATIO, math.nan, (*MODEL.effects, law)))
    assert found.solution.amplitude("motor", "a") == pytest.approx(amplitude, rel=0.02)
    assert found.nrmse < 1.5 * NOISE


def test_a_sensor_is_not_called_the_motors_where_a_formula_does_better() -> None:
    """Seals at the output drag with a power of its speed: the motor side was told at 0.99, at 1.6 noise floors."""
    recording = sensed(3, 22)
    torque, angle = recording.columns["torque_out_Nm"], recording.columns["theta_out_rad"]
    speed = savgol_filter(angle, 25, 2, deriv=1, delta=1e-3)
    torque += 0.1 * torque.std() * np.sign(speed) * np.abs(speed / speed.std()) ** 0.6
    found = discover([recording], SENSED)
    assert found.proposals[0].expression == "a*sign(velocity_out_rad_s)*abs(velocity_out_rad_s)**0.6"
    assert found.verdict == "unexplained" and found.candidates[0].probability < 0.5


def test_the_axis_of_the_motor_leaves_out_a_law_of_it_that_is_there() -> None:
    law = ModelEffect("motor", expression="a*motor_Nm**3")
    fitted = fit([joint(1, saturating)], replace(MODEL, effects=(*MODEL.effects, law)))
    problem, trial = fitted.problem, fitted.problem.trials[0]
    made = RATIO * trial.project(problem.made(fitted.solution, problem.motions[0])[:, None])[:, 0]
    missed = np.abs(saturating(made, made) - RATIO * problem.target)  # few samples about a reversal are not told
    assert np.median(missed) < 0.2 * np.median(np.abs(made - RATIO * problem.target))


def test_no_formula_retells_a_bare_machine_that_the_catalogue_explains() -> None:
    """It took 25 s to find six summands for weight, friction and drag."""
    bare, recording = Model("drive", RATIO, math.nan, (ModelEffect("inertia"),)), joint(1, lambda torque, _: torque)
    assert proposals([recording], bare, lambda what, share: None, Rival(NOISE)) == ()
    lacking_drag = replace(MODEL, effects=tuple(row for row in MODEL.effects if row.name != "viscous_friction"))
    drag = proposals([recording], lacking_drag, lambda what, share: None, Rival(NOISE))
    assert drag[0].expression == "a*velocity_out_rad_s"


def test_beside_a_cause_that_leaves_the_noise_no_longer_formula_is_looked_for() -> None:
    """Drag and iron that saturates are two laws: beside a cause of two only one of one would be shorter."""
    lacking_drag = replace(MODEL, effects=tuple(row for row in MODEL.effects if row.name != "viscous_friction"))
    loud = joint(1, saturating, 8 * NOISE)
    one, two = (
        [row.laws for row in proposals([loud], lacking_drag, lambda what, share: None, Rival(8 * NOISE, n))]
        for n in (1, 2)
    )
    assert max(one, default=0) < 2 == max(two, default=0)


def test_the_torque_of_a_motor_is_no_word_of_two_encoders() -> None:
    with pytest.raises(ModelError, match="motor_Nm: a model tells it with one encoder"):
        user_effect(ModelEffect("motor", expression="a*motor_Nm**3"), "torsion")

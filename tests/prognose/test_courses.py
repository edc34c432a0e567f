"""What a course reads of an indicator, against wear that is put into it here."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.prognose.courses import INDICATORS, LifeCourse, Scales
from edge_daemon.usage.gears import find_gear
from edge_daemon.usage.ledger import rows_of

GEAR = find_gear("CSG-20-100")
ONE = np.ones(len(INDICATORS))
SCALES = Scales(3.0, 5e6, np.array([1.0, 0.0, 0.0, 0.0, 0.0]), ONE, ONE)


def course(rng: np.random.Generator, worn: float) -> LifeCourse:
    """Three thousand hours: the sound goes with the square of the speed and the root of the torque, the heat with both
    and with the day; the speed rises by a fifth for the second half; wear adds `worn` to the logarithm by the end."""
    t = np.arange(1.0, 3001.0)
    speed = 1400.0 * np.exp(0.06 * rng.normal(size=t.size)) * np.where(t > 1500.0, 1.2, 1.0)
    torque = 42.0 * np.exp(0.08 * rng.normal(size=t.size))
    heat = 15.0 * (speed / 1400.0) * (torque / 42.0)
    wear = worn * (t / t[-1]) ** 2
    columns = {
        "speed_in_rpm": speed,
        "torque_cubic_mean_Nm": torque,
        "torque_peak_Nm": 1.7 * torque,
        "temperature_degC": 22.0 + heat + 3.0 * np.sin(t / 24.0 * 2.0 * np.pi) + 0.5 * rng.normal(size=t.size),
        "noise_a0": 1e-6
        * (speed / 1400.0) ** 2
        * (torque / 42.0) ** 0.5
        * np.exp(wear + 0.05 * rng.normal(size=t.size)),
    }
    return LifeCourse(rows_of(GEAR, t, np.ones_like(t), columns), SCALES)


@pytest.mark.parametrize("worn", [0.0, 0.5])
def test_an_indicator_tells_wear_and_not_the_load(worn: float) -> None:
    """The rise of the speed alone is worth 0.36."""
    rng = np.random.default_rng(3)
    read = np.array([course(rng, worn).read(2999)[INDICATORS.index("noise_a0"), -1] for _ in range(5)])
    assert read == pytest.approx(0.95 * worn, abs=0.05)


def test_each_coefficient_of_the_noise_is_read_by_itself() -> None:
    known = course(np.random.default_rng(4), 0.2).known(2999)
    assert dict(zip(INDICATORS, known.tolist(), strict=True)) == {
        name: name in ("noise", "warmth", "noise_a0") for name in INDICATORS
    }

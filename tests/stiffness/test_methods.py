"""Three measurements of one stiffness on motions whose answer is known in closed form.

The joint is J * (u'' - phi'') = G phi, u the motor seen from the output; in steady state each tone of u gives its
twist by the complex stiffness G(omega), so nothing here integrates or filters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from edge_daemon.effects.model import ModelEffect
from edge_daemon.errors import BadInput
from edge_daemon.rig.recording import simulate
from edge_daemon.stiffness.methods import METHODS, StiffnessMeasurement, compare_methods, measure

RATE = 1000.0
RATIO = 100.0
INERTIA = 0.3
TONES_HZ = (1.3, 3.7, 7.9, 13.1)
BITS = 22


@dataclass(frozen=True)
class Gear:
    stiffness: float = 2.0e4
    damping: float = 15.0
    creep: float = 0.0
    """a second spring in series with a dashpot: it only holds against motion (Maxwell 1867)"""
    creep_s: float = 0.05

    def at(self, omega: float) -> complex:
        s = 1j * omega
        return self.stiffness + self.damping * s + self.creep * s * self.creep_s / (1 + s * self.creep_s)


Columns = dict[str, np.ndarray]


def read(columns: Columns, rng: np.random.Generator) -> Columns:
    """As sensors give it: steps of 22 bits on the output and 20 on the motor, 0.02 N m on the torque."""
    out = dict(columns)
    for name, bits in (("theta_in_rad", 20), ("theta_out_rad", BITS)):
        step = 2 * math.pi / 2**bits
        out[name] = np.round(columns[name] / step + rng.normal(0, 0.3, len(columns[name]))) * step
    if "torque_out_Nm" in out:
        out["torque_out_Nm"] = columns["torque_out_Nm"] + rng.normal(0, 0.02, len(columns["torque_out_Nm"]))
    return out


def shaken(
    gear: Gear, rng: np.random.Generator, seconds: float = 20.0, sensor: bool = False
) -> tuple[np.ndarray, Columns]:
    """The motor shakes the gear with four tones; the output inertia answers."""
    time_s = np.arange(round(seconds * RATE)) / RATE
    motor, twist, torque = (np.zeros(len(time_s)) for _ in range(3))
    for frequency in TONES_HZ:
        omega = 2 * math.pi * frequency
        wave = np.exp(1j * (omega * time_s + rng.uniform(0, 2 * math.pi))) * 0.5 / omega
        answer = -INERTIA * omega**2 / (gear.at(omega) - INERTIA * omega**2)
        motor += wave.real
        twist += (answer * wave).real
        torque += (gear.at(omega) * answer * wave).real
    columns = {"theta_in_rad": RATIO * motor, "theta_out_rad": motor - twist}
    return time_s, read(columns | ({"torque_out_Nm": torque} if sensor else {}), rng)


def held(gear: Gear, rng: np.random.Generator, loop_rad: float = 0.0) -> tuple[np.ndarray, Columns]:
    """The motor stands; torque goes up and down in steps of three seconds, and the twist rings down after each."""
    levels = np.array([0, 5, 10, 15, 20, 15, 10, 5, 0, -5, -10, -15, -20, -15, -10, -5, 0], dtype=float)
    time_s = np.arange(round(len(levels) * 3.0 * RATE)) / RATE
    torque, twist = np.zeros(len(time_s)), np.zeros(len(time_s))
    natural = math.sqrt(gear.stiffness / INERTIA)
    zeta = gear.damping / 2 / math.sqrt(gear.stiffness * INERTIA)
    ring = natural * math.sqrt(1 - zeta**2)
    for i, step in enumerate(np.diff(levels, prepend=0.0)):
        t = np.maximum(time_s - 3.0 * i, 0.0)
        decay = np.exp(-zeta * natural * t) * (np.cos(ring * t) + zeta * natural / ring * np.sin(ring * t))
        torque += step * (time_s >= 3.0 * i)
        twist += step / gear.stiffness * (1 - decay) * (time_s >= 3.0 * i)
        twist += (
            loop_rad
            / 2
            * (np.sign(step) - np.sign(np.diff(levels, prepend=0.0)[i - 1]))
            * (time_s >= 3.0 * i)
            * (i > 1)
        )
    columns = {
        "theta_in_rad": np.full(len(time_s), 31.0),
        "theta_out_rad": rng.uniform(0, 1) - twist,
        "torque_out_Nm": torque,
    }
    return time_s, read(columns, rng)


def turned(gear: Gear, rng: np.random.Generator) -> tuple[np.ndarray, Columns]:
    """The motor turns slowly against a torque that swings slowly."""
    time_s = np.arange(round(60 * RATE)) / RATE
    omega = 2 * math.pi * 0.05
    wave = 20.0 * np.exp(1j * omega * time_s)
    motor = 0.2 * time_s
    twist = (wave / gear.at(omega)).real + 1.2e-4 * np.sin(2 * RATIO * motor)
    columns = {"theta_in_rad": RATIO * motor, "theta_out_rad": motor - twist, "torque_out_Nm": wave.real}
    return time_s, read(columns, rng)


def found(method: str, gear: Gear, seed: int) -> StiffnessMeasurement:
    rng = np.random.default_rng(seed)
    time_s, columns = held(gear, rng) if method == "static" else shaken(gear, rng)
    return measure(method, time_s, columns, RATIO, INERTIA)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", METHODS)
def test_each_method_is_right_within_its_sd(method: str) -> None:
    gear = Gear()
    rows = [found(method, gear, seed) for seed in range(12)]
    scores = np.array([(row.stiffness_Nm_per_rad - gear.stiffness) / row.sd_Nm_per_rad for row in rows])
    assert max(row.sd_Nm_per_rad for row in rows) < 2e-3 * gear.stiffness
    assert 0.4 < math.sqrt(np.mean(scores**2)) < 1.7
    assert np.abs(scores).max() < 4


def test_slow_turning_is_static_too_and_the_kinematic_error_does_not_leak() -> None:
    gear = Gear()
    row = measure("static", *turned(gear, np.random.default_rng(2)), RATIO, INERTIA)
    assert abs(row.stiffness_Nm_per_rad - gear.stiffness) < 3 * row.sd_Nm_per_rad < 0.01 * gear.stiffness


def test_all_three_agree_on_a_plain_gear() -> None:
    compared = compare_methods([found(method, Gear(), 7) for method in METHODS])
    assert compared.agree and len(compared.pairs) == 3
    assert "agree" in compared.verdict


def test_what_depends_on_speed_is_missed_at_rest() -> None:
    """A Maxwell element: nothing at rest, up to a third more stiffness in motion, more at higher frequency."""
    gear = Gear(creep=6e3)
    static, response, dynamic = (found(method, gear, 3) for method in METHODS)
    assert abs(static.stiffness_Nm_per_rad - gear.stiffness) < 4 * static.sd_Nm_per_rad
    omegas = [2 * math.pi * f for f in (TONES_HZ[0], TONES_HZ[-1])]
    low, high = (gear.at(omega).real for omega in omegas)
    for row in (response, dynamic):
        assert low < row.stiffness_Nm_per_rad < high
        assert row.stiffness_Nm_per_rad > static.stiffness_Nm_per_rad + 10 * static.sd_Nm_per_rad
    compared = compare_methods([static, response, dynamic])
    assert not compared.agree and "softer at rest" in compared.verdict
    assert not response.limits[1].kept  # frequency-dependent
    assert response.details["lowest_Nm_per_rad"] == pytest.approx(low, rel=0.01)
    assert response.details["highest_Nm_per_rad"] == pytest.approx(high, rel=0.01)
    assert not dynamic.limits[2].kept  # the model is not complete


def test_damping_alone_separates_nothing() -> None:
    rows = [found(method, Gear(damping=60.0), 4) for method in METHODS]
    assert compare_methods(rows).agree
    for row in rows[1:]:
        assert row.details["damping_Nms_per_rad"] == pytest.approx(60.0, rel=0.02)


def test_a_wrong_inertia_is_a_wrong_stiffness_and_the_stated_doubt_covers_it() -> None:
    rng = np.random.default_rng(5)
    record = shaken(Gear(), rng)
    for method in ("frequency-response", "dynamic"):
        sure = measure(method, *record, RATIO, 1.05 * INERTIA)  # type: ignore[arg-type]
        assert sure.stiffness_Nm_per_rad == pytest.approx(1.05 * Gear().stiffness, rel=0.01)
        doubtful = measure(method, *record, RATIO, 1.05 * INERTIA, 0.05 * INERTIA)  # type: ignore[arg-type]
        assert abs(doubtful.stiffness_Nm_per_rad - Gear().stiffness) < 2 * doubtful.sd_Nm_per_rad
        assert doubtful.random_sd_Nm_per_rad == pytest.approx(sure.sd_Nm_per_rad)
    assert not measure("dynamic", *record, RATIO, INERTIA, 0.05 * INERTIA).limits[0].kept
    with_sensor = shaken(Gear(), rng, sensor=True)
    free = measure("frequency-response", *with_sensor, RATIO, 1.05 * INERTIA, 0.05 * INERTIA)
    assert abs(free.stiffness_Nm_per_rad - Gear().stiffness) < 4 * free.sd_Nm_per_rad < 0.01 * Gear().stiffness


def test_hysteresis_is_seen_at_rest() -> None:
    row = measure("static", *held(Gear(), np.random.default_rng(6), loop_rad=5e-5), RATIO, INERTIA)
    assert not row.limits[1].kept
    assert row.details["hysteresis_rad"] == pytest.approx(5e-5, rel=0.15)
    assert abs(row.stiffness_Nm_per_rad / Gear().stiffness - 1) < 0.02
    assert measure("static", *held(Gear(), np.random.default_rng(6)), RATIO, INERTIA).limits[1].kept


def test_coarse_encoders_are_called_noisy() -> None:
    time_s, columns = shaken(Gear(), np.random.default_rng(8))
    step = 2 * math.pi / 2**14
    coarse = columns | {"theta_out_rad": np.round(columns["theta_out_rad"] / step) * step}
    assert not measure("dynamic", time_s, coarse, RATIO, INERTIA).limits[1].kept
    assert measure("dynamic", time_s, columns, RATIO, INERTIA).limits[1].kept


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("static", "torque_out_Nm: missing"),
        ("frequency-response", "expected at least"),
        ("x", "expected one of static"),
    ],
)
def test_what_a_method_lacks_is_one_line(method: str, message: str) -> None:
    time_s, columns = shaken(Gear(), np.random.default_rng(9), seconds=3.0)
    with pytest.raises(BadInput, match=message):
        measure(method, time_s, columns, RATIO, INERTIA)  # type: ignore[arg-type]


def test_a_torque_that_never_rests_is_not_static() -> None:
    time_s, columns = shaken(Gear(), np.random.default_rng(9), sensor=True)
    with pytest.raises(BadInput, match="steady stretches"):
        measure("static", time_s, columns, RATIO, INERTIA)


def test_the_dynamic_method_knows_what_the_model_has() -> None:
    """Friction that the model has and the method ignores would be taken for stiffness."""
    made = simulate(("coulomb_friction",), 9.0, seed=5, bits_out=22)
    truth = made.truth["parameters"]
    known = [ModelEffect("coulomb_friction")]
    rest = (made.time_s, made.columns, truth["ratio"], truth["inertia_kg_m2"], 0.0)  # type: ignore[index]
    blind, told = measure("dynamic", *rest), measure("dynamic", *rest, known)
    right = truth["stiffness_Nm_per_rad"]  # type: ignore[index]
    assert told.stiffness_Nm_per_rad == pytest.approx(right, rel=5e-4)
    assert abs(blind.stiffness_Nm_per_rad - right) > 5 * abs(told.stiffness_Nm_per_rad - right)
    assert blind.sd_Nm_per_rad > 10 * told.sd_Nm_per_rad
    assert [row.kept for row in told.limits if row.name == "the model is complete"] == [True]

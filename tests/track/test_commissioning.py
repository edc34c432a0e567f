"""What is learned once at commissioning, and the stiffness curve that is drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edge_daemon.config.settings import Sound
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.motion.regressors import Regressors
from edge_daemon.records import Bands
from edge_daemon.sound.noise_estimator import NoiseEstimator
from edge_daemon.track.live import DriveEstimator
from tests.motion import simulated_joint as rig

F_HZ = np.linspace(50.0, 5000.0, 200)
SETTINGS = Sound(source="mic", signal="sound", forget_s=10.0)


def heard(hearing: NoiseEstimator, level: float, first_s: int, last_s: int, rng: np.random.Generator) -> None:
    """White noise of `level` [unit^2/Hz], a spectrum a second."""
    for second in range(first_s, last_s):
        psd = level * rng.gamma(12.0, 1 / 12.0, len(F_HZ))
        hearing.update(Bands("mic", "sound", float(second), F_HZ, psd, 12.0), math.nan)


def test_the_noise_of_commissioning_is_kept_when_the_gear_grows_louder() -> None:
    hearing, rng = NoiseEstimator(SETTINGS, 40.0), np.random.default_rng(1)
    heard(hearing, 1e-8, 0, 30, rng)
    assert hearing.baseline.known is None and 25 < hearing.baseline.heard_s < 40
    heard(hearing, 1e-8, 30, 60, rng)
    known = hearing.baseline.known
    assert known is not None and known[0] == pytest.approx(1e-8, rel=0.05)
    heard(hearing, 5e-8, 60, 120, rng)
    assert hearing.fit is not None and hearing.fit.value[0] == pytest.approx(5e-8, rel=0.1)
    assert hearing.baseline.known is known


def test_a_pause_is_not_commissioning_time() -> None:
    hearing, rng = NoiseEstimator(SETTINGS, 40.0), np.random.default_rng(2)
    heard(hearing, 1e-8, 0, 10, rng)
    heard(hearing, 1e-8, 10_000, 10_010, rng)
    assert hearing.baseline.heard_s < 20


def test_the_noise_baseline_survives_a_restart_but_not_another_sensor() -> None:
    hearing, rng = NoiseEstimator(SETTINGS, 20.0), np.random.default_rng(3)
    heard(hearing, 1e-8, 0, 30, rng)
    again = NoiseEstimator(SETTINGS, 20.0)
    assert again.restore(hearing.state())
    assert np.array_equal(again.baseline.known, hearing.baseline.known)  # type: ignore[arg-type]
    other = NoiseEstimator(Sound(source="mic", signal="sound", reference_hz=500.0), 20.0)
    assert not other.restore(hearing.state())
    for blob in (b"", b"{}", hearing.state()[:-9], hearing.state().replace(b'"total":[', b'"total":[1,')):
        assert not again.restore(blob)
    assert other.baseline.known is None and again.baseline.known is not None


def test_the_stiffness_curve_is_the_joints_own_within_its_band() -> None:
    joint = rig.Joint(out_bits=20)
    estimator = DriveEstimator(rig.drive_settings(joint, warm_up_s=2.0), rig.model_of(joint))
    assert estimator.spring(np.array([0.0, 1e-4])) is None, "nothing is known before anything moved"
    for block in rig.blocks(joint, *rig.linear(joint, rig.Path(seconds=12.0))):
        estimator.update(block)
    twist = np.linspace(-2e-4, 2e-4, 5)
    found = estimator.spring(twist)
    assert found is not None
    torque, sd = found
    assert sd[2] == 0.0 and sd[0] == sd[4] > 0
    assert np.all(np.abs(torque - joint.stiffness * twist) <= 4 * sd + 1e-12)


def test_a_bent_spring_gives_a_bent_curve() -> None:
    """Columns against the formula of the catalogue: torque = K phi + k1 phi^2 + k2 phi^3, and nothing of friction."""
    names = ("viscous_damping", "linear_stiffness", "coulomb_friction", "polynomial_stiffness")
    model = Model("torsion", 100.0, 0.05, tuple(ModelEffect(name) for name in names))
    twist = np.array([-2e-4, 0.0, 1e-4])
    regressors = Regressors(model)
    columns, places = regressors.springs(twist)
    assert [regressors.keys[i] for i in places] == [
        ("linear_stiffness", "stiffness"),
        ("polynomial_stiffness", "k1"),
        ("polynomial_stiffness", "k2"),
    ]
    assert columns == pytest.approx(np.column_stack((twist, twist**2, twist**3)))

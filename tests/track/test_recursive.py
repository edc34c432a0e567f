"""The block filter against scalar filterpy updates, and against what noise in the columns does."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from edge_daemon.effects.model import FittedParameter, Model, ModelEffect
from edge_daemon.motion.kinematics import filters
from edge_daemon.motion.noise_level import ColumnNoise, Compressed, NoiseLevel, compress
from edge_daemon.motion.regressors import EncoderNoise, Regressors
from edge_daemon.track.consistency import Consistency
from edge_daemon.track.prior import prior
from edge_daemon.track.recursive import AmplitudeFilter

SEED = 20261121


def scalar_reference(columns, torque, mean, prior_sd, noise_sd):
    k = columns.shape[1]
    kalman = KalmanFilter(dim_x=k, dim_z=1)
    kalman.x, kalman.P, kalman.R = mean.reshape(k, 1), np.diag(prior_sd**2), np.array([[noise_sd**2]])
    for row, value in zip(columns, torque, strict=True):
        kalman.update(np.array([[value]]), H=row[None, :])
    return kalman.x[:, 0], kalman.P


@pytest.mark.parametrize("size", [1, 5, 100])
def test_blocks_give_the_posterior_of_scalar_updates(size):
    rng = np.random.default_rng(SEED)
    k, blocks, noise_sd = 6, 4, 0.3
    truth, prior_sd = rng.normal(size=k) * 10, np.full(k, 20.0)
    filt = AmplitudeFilter(np.zeros(k), prior_sd, np.zeros(k))
    columns = rng.normal(size=(blocks * size, k)) * np.array([1, 2, 0.5, 1, 3, 1])
    torque = columns @ truth + noise_sd * rng.normal(size=len(columns))
    for i in range(blocks):
        part = slice(i * size, (i + 1) * size)
        filt.update(compress(columns[part], torque[part]), noise_sd, 0.1)
    mean, covariance = scalar_reference(columns, torque, np.zeros(k), prior_sd, noise_sd)
    np.testing.assert_allclose(filt.value, mean, rtol=1e-9)
    np.testing.assert_allclose(filt.covariance, covariance, rtol=1e-9, atol=1e-9 * covariance.max())


def test_covariance_does_not_wind_up_without_excitation():
    k = 2
    filt = AmplitudeFilter(np.zeros(k), np.array([10.0, 10.0]), np.array([0.1, 0.1]))
    excited = compress(np.eye(k)[[0, 1] * 50], np.tile([3.0, 4.0], 50))
    filt.update(excited, 0.5, 0.1)
    sd = filt.sd
    only_first = compress(np.tile([1.0, 0.0], (100, 1)), np.full(100, 3.0))
    for _ in range(10_000):
        filt.update(only_first, 0.5, 0.1)
    assert filt.sd[1] < 1.2 * sd[1]
    assert np.all(filt.sd <= 10.0)
    np.testing.assert_allclose(filt.value, [3.0, 4.0], rtol=0.05)


def test_drift_is_followed_where_the_data_excite():
    rng = np.random.default_rng(SEED)
    filt = AmplitudeFilter(np.zeros(1), np.array([100.0]), np.array([0.1]))
    truth = 50.0
    for _ in range(2000):
        truth += 0.1 * np.sqrt(0.1) * rng.normal()
        column = rng.normal(size=(20, 1))
        filt.update(compress(column, column[:, 0] * truth + rng.normal(size=20)), 1.0, 0.1)
    assert abs(filt.value[0] - truth) < 4 * filt.sd[0] < 2.0


def test_noise_in_the_columns_is_compensated_and_its_sd_is_honest():
    rng = np.random.default_rng(SEED)
    truth, column_sd, noise_sd, runs = np.array([2.0, -1.0]), 0.5, 0.2, 200
    noise = ColumnNoise(np.diag([column_sd**2, 0.0]), np.zeros(2))
    equation_sd = np.hypot(noise_sd, column_sd * truth[0])
    errors, sds, naive = [], [], []
    for _ in range(runs):
        filt = AmplitudeFilter(np.zeros(2), np.array([30.0, 30.0]), np.zeros(2))
        for _ in range(20):
            clean = rng.normal(size=(50, 2))
            torque = clean @ truth + noise_sd * rng.normal(size=50)
            measured = clean + np.column_stack([column_sd * rng.normal(size=50), np.zeros(50)])
            filt.update(compress(measured, torque), equation_sd, 0.1, noise)
        errors.append(filt.value - truth)
        sds.append(filt.sd)
        naive.append(filt.raw[0] - truth)
    errors, sds = np.array(errors), np.array(sds)
    assert np.mean(naive, axis=0)[0] < -0.3
    assert np.all(np.abs(errors.mean(axis=0)) < 0.2 * sds.mean(axis=0))
    np.testing.assert_allclose(errors.std(axis=0), sds.mean(axis=0), rtol=0.15)


def test_noise_level_sees_both_sides_of_the_columns():
    rng = np.random.default_rng(SEED)
    level = NoiseLevel(0.01)
    for _ in range(100):
        columns = rng.normal(size=(40, 3))
        level.before(compress(columns, 0.5 * rng.normal(size=40)), 1.0, 0.1)
    assert level.sd == pytest.approx(0.5, rel=0.05)
    for _ in range(300):
        innovation = 2.0 * rng.normal(size=3)
        level.after(float(innovation @ innovation), 0.0, 3)
    assert level.sd == pytest.approx(2.0, rel=0.1)


def test_state_round_trip_and_refusal_of_rubbish():
    rng = np.random.default_rng(SEED)
    filt = AmplitudeFilter(np.zeros(3), np.ones(3), np.full(3, 0.01))
    block = compress(rng.normal(size=(10, 3)), rng.normal(size=10))
    filt.update(block, 1.0, 0.1)
    twin = AmplitudeFilter.load(filt.dump())
    filt.update(block, 1.0, 0.1)
    twin.update(block, 1.0, 0.1)
    np.testing.assert_allclose(twin.covariance, filt.covariance, rtol=1e-12)
    state = filt.dump()
    state["mean"][0] = float("nan")
    with pytest.raises(ValueError, match="finite"):
        AmplitudeFilter.load(state)


def test_amplitudes_of_another_meaning_are_what_they_would_have_been_from_the_start():
    rng = np.random.default_rng(8)
    columns, truth = rng.normal(size=(200, 3)), np.array([3.0, -1.0, 0.5])
    torque = columns @ truth + 0.1 * rng.normal(size=200)
    mix, offset = np.eye(3), np.array([0.0, 0.7, 0.0])
    mix[1, 0] = 0.4
    one = AmplitudeFilter(np.zeros(3), np.full(3, 1e3), np.zeros(3))
    one.update(compress(columns, torque), 0.1, 0.1)
    one.rebase(mix, offset)
    back = np.linalg.inv(mix)
    other = AmplitudeFilter(np.zeros(3), np.full(3, 1e3), np.zeros(3))
    other.update(compress(columns @ back, torque + columns @ back @ offset), 0.1, 0.1)
    np.testing.assert_allclose(one.value, other.value, rtol=1e-6)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-5, atol=1e-12)


def test_a_filter_that_errors_lead_on_for_a_second_is_less_sure():
    """Noise that stays for half a second tells five times less than the filter takes it for."""
    rng, truth = np.random.default_rng(SEED), np.array([3.0, -2.0])
    for stays, low, high in ((1, 0.8, 1.2), (50, 3.0, 10.0)):
        filt, steady = AmplitudeFilter(np.zeros(2), np.full(2, 10.0), np.zeros(2)), Consistency(2)
        for _ in range(600):
            columns = np.repeat(rng.normal(size=(50 // stays, 2)), stays, axis=0)
            noise = np.repeat(rng.normal(size=50 // stays), stays)
            filt.update(compress(columns, columns @ truth + noise), 1.0, 0.1)
            steady.follow(*filt.step, 0.1)
        assert np.all((low < steady.wider) & (steady.wider < high))
        assert np.all(abs(filt.value - truth) < 3.5 * filt.sd * steady.wider)


def test_a_shape_begins_where_the_file_says_and_as_sure():
    known = {"rounding": FittedParameter(0.73, 0.02), "width": FittedParameter(5e-5)}
    rows = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"), ModelEffect("bouc_wen_hysteresis", known))
    regressors = Regressors(Model("torsion", 100.0, 0.05, rows))
    filt = prior(regressors, np.ones((20, len(regressors.keys))), 5.0, 1e-3)
    i, j = regressors.index("bouc_wen_hysteresis", "rounding"), regressors.index("bouc_wen_hysteresis", "width")
    assert filt.value[i] == filt.value[j] == 0.0, "counted from the value of the file, as a logarithm"
    assert filt.sd[i] == pytest.approx(0.02 / 0.73) and 0.3 < filt.sd[j] < 1.0


@pytest.mark.parametrize(("sd", "expected"), [(math.nan, 500.0 * 100), (2.0, 50.0), (3e3, 3e3), (1e9, 500.0 * 100)])
def test_a_number_that_its_model_file_does_not_know_is_in_doubt_beforehand(sd, expected):
    """Of two that only their sum tells a file holds values as small as chance made them, and their large sd."""
    rows = (ModelEffect("linear_stiffness", {"stiffness": FittedParameter(50.0, sd)}), ModelEffect("viscous_damping"))
    regressors = Regressors(Model("torsion", 100.0, 0.1, rows))
    filt = prior(regressors, np.full((20, len(regressors.keys)), 1e-2), 5.0, 1e-3)
    assert filt.sd[regressors.index("linear_stiffness", "stiffness")] == pytest.approx(expected)


def test_noise_reaches_columns_that_differ_by_a_factor_with_that_factor():
    """Damping and its change with temperature, at a constant one: no data can tell them apart, nor may their noise."""
    fir, encoder = filters(1000.0, 100.0), EncoderNoise(1e-6, 1e-6)
    rows = tuple(map(ModelEffect, ("linear_stiffness", "viscous_damping", "temperature_friction")))
    regressors = Regressors(Model("torsion", 100.0, 0.1, rows))
    i, j = regressors.index("viscous_damping", "damping"), regressors.index("temperature_friction", "slope")
    for degC in (25.7, 60.0):
        inside = regressors.noise(fir, encoder, False, degC).inside
        assert inside.columns[i, i] > 0
        for both in (i, j):
            assert inside.columns[j, both] == pytest.approx((degC - 25.0) * inside.columns[i, both])
        assert inside.torque[j] == pytest.approx((degC - 25.0) * inside.torque[i])


def test_an_amplitude_that_wrongly_reckoned_noise_makes_surer_is_not_trusted():
    """The columns are alike, and the noise in them is said to be of another kind: undone, it would tell them apart."""
    rng, truth = np.random.default_rng(SEED), np.array([6.0, 0.5])
    noise = ColumnNoise(1e-3 * np.outer([0.6, 9.0], [0.6, 9.0]), np.zeros(2))
    filt, right = (AmplitudeFilter(np.zeros(2), np.array([10.0, 10.0]), np.zeros(2)) for _ in range(2))
    for _ in range(200):
        columns = np.outer(rng.normal(size=100), [1.0, 0.7])
        block = compress(columns, columns @ truth + 0.1 * rng.normal(size=100))
        filt.update(block, 0.1, 0.1, noise)
        right.update(block, 0.1, 0.1, ColumnNoise(1e-6 * np.outer([1.0, 0.7], [1.0, 0.7]), np.zeros(2)))
    assert filt.sd.max() < 2.0 and not filt.trusted.any(), "the difference cannot be known"
    assert right.sd.min() > 4.0 and right.trusted.all()


def test_a_filter_that_was_surer_than_its_drift_allows_comes_to_the_riccati_variance():
    """Fine data, then coarse ones: drift and data balance at the root of P = (P + q) R / (P + q + R)."""
    drift, coarse, rows = 20.0, 250.0, 30
    filt = AmplitudeFilter(np.zeros(1), np.array([1e5]), np.array([1.0]))
    filt.drift_by(0, drift)
    for noise in (*[2.5] * 10, *[coarse] * 1500):
        filt.update(Compressed(np.full((1, 1), math.sqrt(rows)), np.zeros(1), 0.0, rows), noise, 0.3)
    q, r = drift**2 * 0.3, coarse**2 / rows
    balanced = (-q + math.sqrt(q**2 + 4 * q * r)) / 2
    assert math.isclose(float(filt.sd[0]) ** 2, balanced, rel_tol=0.02)


@pytest.mark.slow
def test_the_doubt_of_a_shape_that_is_held_is_carried_into_the_amplitudes():
    """Dry friction whose smoothing is drawn from what the file says of it, beside a damping that takes up the rest."""
    rng, truth, held, known, runs = np.random.default_rng(SEED), np.array([6.0, 2.0]), 0.03, 0.2, 200
    errors, sds, bare = [], [], []
    for smoothing in held * np.exp(known * rng.normal(size=runs)):
        filt = AmplitudeFilter(np.zeros(2), np.full(2, 100.0), np.zeros(2))
        for _ in range(40):
            rate = 0.1 * rng.normal(size=100)
            columns = np.column_stack((rate, np.tanh(rate / held)))
            moved = np.tanh(rate / (held * np.exp(known))) - columns[:, 1]
            torque = truth[0] * rate + truth[1] * np.tanh(rate / smoothing) + 0.1 * rng.normal(size=100)
            there = filt.value[1] * moved[:, None]
            filt.update(compress(columns, torque), 0.1, 0.1, held=columns.T @ there)
        errors.append(filt.value - truth)
        sds.append(np.hypot(filt.sd, filt.held_sd))
        bare.append(filt.sd)
    z, without = np.array(errors) / np.array(sds), np.array(errors) / np.array(bare)
    assert np.all(np.sqrt(np.mean(without**2, axis=0)) > 3.0), "as if the shape were known"
    assert np.all(abs(np.sqrt(np.mean(z**2, axis=0)) - 1.0) < 0.2), z.std(axis=0)
    again = AmplitudeFilter.load(filt.dump())
    np.testing.assert_allclose(again.held_sd, filt.held_sd)

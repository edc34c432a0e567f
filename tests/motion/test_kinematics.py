"""The kernels against calculus: a tone comes back with the exact derivative's gain and no delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_daemon.motion.kinematics import KinematicsError, filters, motion_of, uniform, unrounded
from edge_daemon.records import Array


@pytest.mark.parametrize("tone_hz", [1.0, 20.0, 60.0, 100.0])
def test_one_kernel_three_derivatives(tone_hz: float) -> None:
    fir = filters(1000.0, 100.0)
    t = np.arange(2000) / 1000.0
    w = 2 * np.pi * tone_hz
    inside = slice(fir.delay, -fir.delay)
    gain = (fir.value * np.cos(w * np.arange(-fir.delay, fir.delay + 1) / 1000.0)).sum()
    for kernel, truth in (
        (fir.value, np.sin(w * t)),
        (fir.first, w * np.cos(w * t)),
        (fir.second, -(w**2) * np.sin(w * t)),
    ):
        got = fir.apply(kernel, np.sin(w * t))[inside]
        assert np.abs(got - gain * truth[inside]).max() < 2e-3 * np.abs(truth).max()


def test_exact_on_a_parabola() -> None:
    fir = filters(500.0, 40.0)
    t = np.arange(600) / 500.0
    x = 3 + 2 * t - 5 * t**2
    inside = slice(fir.delay, -fir.delay)
    np.testing.assert_allclose(fir.apply(fir.first, x)[inside], (2 - 10 * t)[inside], atol=1e-8)
    np.testing.assert_allclose(fir.apply(fir.second, x)[inside], -10.0, atol=1e-6)


def test_what_is_beyond_the_filter_hardly_passes_it() -> None:
    """Beyond comes as it is; what passes leaves nothing; at the edge a tenth is left of both."""
    fir = filters(1000.0, 100.0)
    t = np.arange(4000) / 1000.0
    inside = slice(4 * fir.delay, -4 * fir.delay)

    def gain(tone_hz: float, *kernels: Array) -> float:
        signal = np.sin(2 * np.pi * tone_hz * t)
        for kernel in kernels:
            signal = fir.apply(kernel, signal)
        return float(np.abs(signal[inside]).max())

    assert gain(40.0, fir.beyond) < 1e-3
    assert gain(250.0, fir.beyond) == pytest.approx(1.0, abs=1e-3)
    common = [gain(tone_hz, fir.beyond, fir.value) for tone_hz in np.arange(60.0, 160.0, 5.0)]
    assert max(common) == pytest.approx(0.75**3 / 4, abs=2e-3)


def test_what_is_beyond_the_filter_does_not_hang_on_how_softly_it_ends() -> None:
    """Beyond one that makes a noise white most of its own band lay, and with that the noise of a torque."""
    fir = filters(250.0, 100.0)
    soft = np.convolve(fir.value, filters(250.0, 10.0).value)
    tone = np.sin(2 * np.pi * 30.0 * np.arange(2000) / 250.0)
    whitened = replace(fir, value=soft)
    inside = slice(4 * fir.delay, -4 * fir.delay)
    assert np.abs(whitened.apply(whitened.beyond, tone)[inside]).max() < 1e-3


def test_cut_off_is_half_amplitude_and_stop_band_is_dark() -> None:
    fir = filters(1000.0, 100.0)
    k = np.arange(-fir.delay, fir.delay + 1) / 1000.0
    response = lambda f: float((fir.value * np.cos(2 * np.pi * f * k)).sum())  # noqa: E731
    assert response(100.0) == pytest.approx(0.5, abs=0.01)
    assert abs(response(200.0)) < 1e-3


def test_cut_off_above_nyquist_is_refused() -> None:
    with pytest.raises(ValueError, match="cutoff_hz"):
        filters(1000.0, 480.0)


def test_motion_of_a_known_motion() -> None:
    t = np.arange(3000) / 1000.0
    out = np.sin(2 * np.pi * 3 * t)
    twist = 1e-4 * np.sin(2 * np.pi * 5 * t)
    motion, valid = motion_of(
        uniform(t, {"theta_in_rad": 100 * (out + twist), "theta_out_rad": out}), 100.0, 0.2, 150.0
    )
    np.testing.assert_allclose(motion.twist_rad[valid], twist[valid], atol=1e-9)
    np.testing.assert_allclose(motion.torque_Nm[valid], (-0.2 * (6 * np.pi) ** 2 * out)[valid], atol=2e-3)
    assert not valid[0] and not valid[-1] and valid[1500]


def test_gap_is_bridged_and_marked() -> None:
    t = np.delete(np.arange(1000) / 1000.0, slice(400, 450))
    even = uniform(t, {"theta_out_rad": t})
    assert len(even.time_s) == 1000
    assert not even.valid[401:449].any() and even.valid[:400].all() and even.valid[451:].all()
    np.testing.assert_allclose(even.columns["theta_out_rad"], even.time_s, atol=1e-12)


def test_what_lies_before_the_first_known_value_or_after_the_last_is_not_known() -> None:
    """A channel that begins late, or ends early, was held at that value for the rest."""
    t = np.arange(1000) / 1000.0
    known = (t > 0.3) & (t < 0.7)
    even = uniform(t, {"theta_out_rad": t, "torque_in_Nm": np.where(known, 1.0, np.nan)})
    assert even.valid[310:690].all() and not even.valid[:250].any() and not even.valid[750:].any()


def test_missing_channel_is_named() -> None:
    with pytest.raises(KinematicsError, match="theta_in_rad"):
        motion_of(uniform(np.arange(900) / 1e3, {"theta_out_rad": np.zeros(900)}), 100.0, 0.1, 100.0)


def test_a_lost_sample_is_bridged_to_encoder_accuracy() -> None:
    t = np.arange(2000) / 1000.0
    x = 0.01 * np.sin(2 * np.pi * 13 * t)
    holes = x.copy()
    holes[50:1950:37] = np.nan
    even = uniform(t, {"theta_out_rad": holes})
    assert even.valid.all()
    np.testing.assert_allclose(even.columns["theta_out_rad"], x, atol=1e-6)


def test_stamps_that_nearly_meet_and_err_swing_nothing_out() -> None:
    """Late ticks of a logger, of which some meet: a cubic through them was 26 times as wrong as straight lines."""
    rng = np.random.default_rng(5)
    step_s = 0.004
    taken_s = np.sort(step_s * (np.arange(5000) + rng.uniform(-0.9, 0.9, 5000)))
    stamps_s = taken_s + 0.08 * step_s * rng.normal(size=5000)
    even = uniform(stamps_s, {"theta_out_rad": np.sin(4 * taken_s)})
    truth = np.sin(4 * even.time_s)
    straight = np.interp(even.time_s, np.sort(stamps_s), np.sin(4 * taken_s)[np.argsort(stamps_s)])
    wrong, plain = (float(np.std((row - truth)[10:-10])) for row in (even.columns["theta_out_rad"], straight))
    assert wrong < 1.5 * plain


@pytest.mark.parametrize(
    ("rate_hz", "decimals", "lost"), [(350.0, 5, 0.0), (350.0, 5, 0.02), (333.0, 3, 0.0), (60.0, 2, 0.0)]
)
def test_stamps_of_an_even_clock_are_as_they_were_before_they_were_rounded(
    rate_hz: float, decimals: int, lost: float
) -> None:
    """A second derivative at 350 Hz held lines at 50 and 100 Hz, for which a load that swings was named at 0.98."""
    taken_s = 1.234567 + np.arange(4000) / rate_hz
    taken_s = taken_s[np.random.default_rng(3).uniform(size=4000) >= lost]
    stamps_s = unrounded(np.round(taken_s, decimals))
    assert np.abs(np.diff(stamps_s) - np.diff(taken_s)).max() < 2e-8
    even = uniform(np.round(taken_s, decimals), {"theta_out_rad": np.sin(4 * taken_s)})
    assert 1 / np.diff(even.time_s).mean() == pytest.approx(rate_hz, rel=1e-5)


@pytest.mark.parametrize("seed", range(40))
def test_rounded_stamps_of_any_steps_rise_as_they_did(seed: int) -> None:
    """Steps of two sizes, as many of either, have none near their median: a warning, and no number."""
    rng = np.random.default_rng(seed)
    steps = [1, 4] * 20 if seed == 0 else rng.integers(1, rng.integers(2, 40), rng.integers(3, 60))
    stamps_s = unrounded(np.cumsum(steps) * 10.0 ** -rng.integers(0, 6))
    assert np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all()


@pytest.mark.parametrize(("jitter_s", "better"), [(5e-5, 0.3), (2e-4, 0.75), (6e-4, 1.01)])
def test_stamps_err_by_less_than_rounding_where_the_clock_does(jitter_s: float, better: float) -> None:
    rng = np.random.default_rng(3)
    taken_s = np.arange(4000) / 333 + jitter_s * rng.uniform(-1.7, 1.7, 4000)
    rounded_s = np.round(taken_s, 3)
    errors = [np.std(stamps_s - taken_s) for stamps_s in (unrounded(rounded_s), rounded_s)]
    assert errors[0] < better * errors[1]


@pytest.mark.parametrize("lost", [0.0, 0.01])
@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
def test_a_grid_lies_along_the_clock_about_which_stamps_scatter(start_s: float, lost: float) -> None:
    """At the median interval, which is not quite the clock's, it slid over the samples: of a wave of four samples the
    cubic between them lost 3 %, and a ripple seemed to fall with speed."""
    rng = np.random.default_rng(7)
    time_s = start_s + (np.arange(8000) + 0.02 * rng.uniform(-1, 1, 8000)) / 400.0
    time_s = time_s[rng.uniform(size=8000) >= lost]
    wave = np.sin(2 * np.pi * 90.0 * (time_s - start_s))
    even = uniform(time_s, {"torque": wave})
    true = np.sin(2 * np.pi * 90.0 * (even.time_s - start_s))
    following = np.clip(np.searchsorted(time_s, even.time_s - 0.5 / 400.0), 0, len(time_s) - 1)
    seen = np.abs(time_s[following] - even.time_s) < 0.25 / 400.0
    seen[:3] = seen[-3:] = False
    assert np.count_nonzero(seen) > 0.98 * len(time_s)
    assert abs(even.columns["torque"][seen] @ true[seen] / (true[seen] @ true[seen]) - 1) < 4e-3


@pytest.mark.parametrize("first", [0.0, 1.6e9])
def test_a_first_stamp_before_the_clock_was_set_asks_for_rows_and_not_for_its_time_span(first: float) -> None:
    time_s = 1.7e9 + np.arange(5000) / 1000
    time_s[0] = first
    wave = np.sin(2 * np.pi * np.arange(5000) / 1000)
    even = uniform(time_s, {"theta": wave})
    assert len(even.time_s) < 4 * len(time_s)
    kept = even.columns["theta"][-4990:]
    np.testing.assert_allclose(kept, wave[-4990:], atol=0.01)  # stamps since 1970 end at 0.2 us
    assert even.valid[-4990:].all() and not even.valid[10:-5010].any()


def test_a_motion_begins_at_its_own_speed() -> None:
    """What is simulated begins there: a speed that was held back pushes it, and hysteresis remembers that."""
    fir = filters(1000.0, 280.0)
    t = np.arange(1000) / 1000.0
    w = 2 * np.pi * 3.0
    speed = fir.apply(fir.first, np.sin(w * t + 0.6))
    assert speed[[0, -1]] == pytest.approx(w * np.cos(w * t[[0, -1]] + 0.6), rel=0.02)

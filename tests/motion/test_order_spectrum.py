"""The order spectrum: what chance makes, what a line is, what it takes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from edge_daemon.motion.left_over import LeftOver
from edge_daemon.motion.order_spectrum import LineFit, OrderSamples, OrderScale, spectrum, strongest
from edge_daemon.records import Array

ROWS, RATE_HZ = 6000, 300.0


def samples(
    residual: Array,
    angle: Array,
    carriers: Array | None = None,
    ends: tuple[int, ...] = (),
    fitted: Array | None = None,
) -> OrderSamples:
    pace = np.abs(np.gradient(angle)) * RATE_HZ / (2 * np.pi)
    carried = np.ones((1, len(angle))) if carriers is None else carriers
    beside = np.empty((len(angle), 0)) if fitted is None else fitted
    return OrderSamples(OrderScale(carried, angle, pace, 100.0, RATE_HZ, ends), LeftOver.of(residual, beside))


def swept(turns: float) -> Array:
    """There and back at changing speed."""
    t = np.arange(ROWS) / RATE_HZ
    return np.asarray(np.pi * turns * (np.sin(2 * np.pi * 0.11 * t) + 0.1 * np.sin(2 * np.pi * 0.9 * t)))


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_noise_makes_no_line_whatever_its_spectrum(memory: float) -> None:
    found = 0
    for seed in range(60):
        noise = lfilter([1.0], [1.0, -memory], np.random.default_rng(seed).normal(size=ROWS))
        found += strongest(samples(noise, swept(20.0))) is not None
    assert found <= 1


@pytest.mark.parametrize("order", [0.47, 2.0, 7.13, 31.0])
def test_a_line_is_found_to_a_hundredth_of_its_width(order: float) -> None:
    angle = swept(20.0)
    noise = np.random.default_rng(2).normal(size=ROWS)
    line = strongest(samples(0.4 * np.sin(order * angle + 0.3) + noise, angle))
    assert line is not None and line.chance < 1e-6
    assert line.order == pytest.approx(order, abs=0.1 / 20)
    assert line.fall == pytest.approx(0.5 * 0.4**2 * ROWS, rel=0.5)


def test_power_is_that_of_least_squares() -> None:
    """Over a line, against a fit written out; sorting into bins of the angle takes next to nothing."""
    angle = swept(6.0)
    signal = np.sin(5 * angle) + 0.1 * np.random.default_rng(4).normal(size=ROWS)
    taken = samples(signal, angle)
    seen = spectrum(taken.residual.signal, taken.scale)
    near = np.flatnonzero(np.abs(seen.order - 5) < 0.15)
    assert len(near) > 3
    for i in near.tolist():
        wave = seen.order[i] * angle
        alone, all_three = np.ones((ROWS, 1)), np.stack((np.ones(ROWS), np.sin(wave), np.cos(wave)), axis=1)
        left = [float(np.linalg.lstsq(c, signal, rcond=None)[1][0]) for c in (alone, all_three)]
        assert seen.fall[i] == pytest.approx(left[0] - left[1], rel=0.03)


def test_none_below_two_turns_of_travel() -> None:
    few = swept(0.85)  # 1.9 turns from end to end
    assert np.ptp(few) < 4 * np.pi
    assert strongest(samples(np.sin(7 * few), few)) is None
    more = swept(1.9)
    assert strongest(samples(np.sin(7 * more) + 0.1 * np.random.default_rng(1).normal(size=ROWS), more)) is not None


def test_a_line_that_grows_with_something_stands_out_beside_it() -> None:
    angle = swept(20.0)
    size = 1 + np.sin(np.arange(ROWS) / 400.0)
    signal = size * np.sin(3 * angle) + np.random.default_rng(3).normal(size=ROWS)
    plain, carried = (strongest(samples(signal, angle, row)) for row in (np.ones((1, ROWS)), size[None]))
    assert plain is not None and carried is not None and carried.fall > plain.fall
    assert carried.order == pytest.approx(3.0, abs=0.002)


def test_what_was_fitted_already_is_not_found_again() -> None:
    angle = swept(20.0)
    signal = np.sin(2 * angle)
    taken = np.stack((np.sin(2 * angle), np.cos(2 * angle)), axis=1)
    signal = signal + np.random.default_rng(5).normal(size=ROWS)
    assert LineFit(samples(signal, angle), 2.0).fall(2.0) > 1000
    assert abs(LineFit(samples(signal, angle, fitted=taken), 2.0).fall(2.0)) < 1.0


def test_a_line_of_two_recordings_is_found_beside_the_broad_one_of_the_shorter() -> None:
    """Three turns make a line so broad that forty turns with a tenth of its size do not stand out of it."""
    short, long = swept(1.4), swept(20.0)
    angle = np.concatenate((short, long))
    size = np.repeat((1.0, 0.1), ROWS)
    signal = size * (np.sin(2.84 * angle + 0.8) + 0.02 * np.random.default_rng(5).normal(size=2 * ROWS))
    found = strongest(samples(signal, angle, ends=(ROWS,)))
    assert found is not None and found.order == pytest.approx(2.84, abs=0.1 / 20)
    without = strongest(samples(signal, angle))
    assert without is None or without.chance > found.chance


def test_noise_of_several_recordings_makes_no_line_either() -> None:
    found = 0
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=2 * ROWS)
        both = samples(noise, np.concatenate((swept(3.0), swept(20.0))), ends=(ROWS,))
        found += strongest(both) is not None
    assert found <= 1


@pytest.mark.parametrize("pace_hz", [14.3, 33.0])
def test_at_one_speed_no_line_is_where_the_filter_passes_nothing(pace_hz: float) -> None:
    """A band's highest order is folded into what the filter passes there, its lower ones are not."""
    time_s = np.arange(2300) / 1000.0
    angle = 2 * np.pi * pace_hz * time_s
    for order in np.arange(8.0, 64.0, 0.5):
        made = np.sin(order * angle) + 0.1 * np.random.default_rng(5).normal(size=len(angle))
        scale = OrderScale(np.ones((1, len(angle))), angle, np.full(len(angle), pace_hz), 100.0, 1000.0)
        line = strongest(OrderSamples(scale, LeftOver.of(made, np.empty((len(angle), 0)))))
        near = [] if line is None else [line.order + k / scale.turns for k in (-0.5, 0.0, 0.5)]
        assert line is None or any(scale.passed(there).all() for there in near)

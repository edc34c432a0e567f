"""Rows made equally noisy, against noise that is drawn here: its filter is a moving average, its spectrum a sum."""

import numpy as np
import pytest

from edge_daemon.motion.whitening import ORDER, TRANSFORM, Whitening

KERNEL = np.hanning(13)[1:-1] / np.hanning(13)[1:-1].sum()
WHITE, REST = 1.0, 2.0
"""sd of the white noise, and of the noise that passes the kernel"""


def whitening():
    made = Whitening()
    made.expect(WHITE**2, REST**2 * np.abs(np.fft.rfft(KERNEL, TRANSFORM)) ** 2)
    return made


def noise(rng, n):
    return WHITE * rng.normal(size=n) + np.convolve(REST * rng.normal(size=n + len(KERNEL) - 1), KERNEL, "valid")


def passed(made, columns, torque, size=100):
    """All blocks through it, without the rows that say nothing."""
    parts = [made.rows(columns[i : i + size], torque[i : i + size]) for i in range(0, len(torque), size)]
    columns, torque = (np.concatenate(part) for part in zip(*parts, strict=True))
    good = np.isfinite(torque)
    assert np.count_nonzero(~good) == ORDER and not good[:ORDER].any()
    return columns[good], torque[good]


def test_what_comes_out_is_white_and_as_loud_as_said():
    made, n = whitening(), 100_000
    _, left = passed(made, np.zeros((n, 1)), noise(np.random.default_rng(1), n))
    assert np.var(left) == pytest.approx(made.white_rad2, rel=0.03)
    alike = [np.mean(left[k:] * left[:-k]) / np.var(left) for k in range(1, 30)]
    assert np.abs(alike).max() < 4 / np.sqrt(n) + 0.01


def test_rows_say_the_same_of_the_amplitudes_across_blocks_and_say_it_more_surely():
    rng, t = np.random.default_rng(2), np.arange(2000) / 1000.0
    columns = np.column_stack((np.sin(2 * np.pi * 3.0 * t), np.sin(2 * np.pi * 190.0 * t)))
    exact = np.array([3.0, -2.0])
    assert np.linalg.lstsq(*passed(whitening(), columns, columns @ exact), rcond=None)[0] == pytest.approx(exact)
    plain, white, stated = [], [], []
    for _ in range(150):
        torque = columns @ exact + noise(rng, len(t))
        plain.append(np.linalg.lstsq(columns, torque, rcond=None)[0])
        made = whitening()
        rows, left = passed(made, columns, torque)
        white.append(np.linalg.lstsq(rows, left, rcond=None)[0])
        stated.append(np.sqrt(made.white_rad2 * np.diag(np.linalg.inv(rows.T @ rows))))
    assert np.std(white, axis=0) == pytest.approx(stated[0], rel=0.18), "three sd of the scatter of 150"
    assert np.std(white, axis=0)[0] < 1.05 * np.std(plain, axis=0)[0]


def test_noise_that_is_white_is_left_alone_and_a_gap_starts_anew():
    made, rng = Whitening(), np.random.default_rng(3)
    made.expect(WHITE**2, np.zeros(TRANSFORM // 2 + 1))
    columns, torque = rng.normal(size=(50, 3)), rng.normal(size=50)
    same = made.rows(columns, torque)
    assert same[0] is columns and same[1] is torque and made.white_rad2 == pytest.approx(WHITE**2)
    made = whitening()
    made.rows(columns, torque)
    assert np.isfinite(made.rows(columns, torque)[1]).all()
    made.forget()
    assert np.count_nonzero(np.isnan(made.rows(columns, torque)[1])) == ORDER


def test_slow_noise_alone_is_made_white_as_far_as_it_goes():
    made, n = Whitening(), 20_000
    made.expect(0.0, REST**2 * np.abs(np.fft.rfft(KERNEL, TRANSFORM)) ** 2)
    slow = np.convolve(REST * np.random.default_rng(4).normal(size=n + len(KERNEL) - 1), KERNEL, "valid")
    _, left = passed(made, np.zeros((n, 1)), slow)
    assert 0.3 * made.white_rad2 < np.var(left) < made.white_rad2, "a little that is white is always allowed for"

"""What columns leave: against least squares written out."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.motion.left_over import LeftOver

ROWS = 400


def test_what_is_left_is_that_of_least_squares_however_the_columns_came() -> None:
    rng = np.random.default_rng(1)
    columns, signal = rng.normal(size=(ROWS, 5)) * (1e-6, 1.0, 1e4, 1.0, 1.0), rng.normal(size=ROWS)
    wanted = signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]
    at_once = LeftOver.of(signal, columns)
    step_by_step = LeftOver.of(signal, columns[:, :2]).beside(columns[:, 2:3]).beside(columns[:, 3:])
    for left in (at_once, step_by_step):
        assert left.signal == pytest.approx(wanted, abs=1e-9)
        assert left.basis.T @ left.basis == pytest.approx(np.eye(5), abs=1e-9)
    assert at_once.power == pytest.approx(float(wanted @ wanted))


def test_columns_that_others_make_and_empty_ones_count_for_nothing() -> None:
    rng = np.random.default_rng(2)
    columns, signal = rng.normal(size=(ROWS, 3)), rng.normal(size=ROWS)
    left = LeftOver.of(signal, columns)
    again = left.beside(np.stack((columns @ (1.0, -2.0, 3.0), np.zeros(ROWS)), axis=1))
    assert again.basis.shape == (ROWS, 3)
    assert again.signal == pytest.approx(left.signal, abs=1e-9)
    assert LeftOver.of(signal, np.zeros((ROWS, 2))).signal == pytest.approx(signal)


def test_some_rows_alone_are_fitted_anew() -> None:
    rng = np.random.default_rng(3)
    columns, signal = rng.normal(size=(ROWS, 3)), rng.normal(size=ROWS)
    some = rng.random(ROWS) < 0.3
    wanted = signal[some] - columns[some] @ np.linalg.lstsq(columns[some], signal[some], rcond=None)[0]
    assert LeftOver.of(signal, columns).within(some).signal == pytest.approx(wanted, abs=1e-9)

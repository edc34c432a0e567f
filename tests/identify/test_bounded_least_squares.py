"""Least squares within bounds, against another solver."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from edge_daemon.identify.bounded_least_squares import solve


def test_no_bound_is_kept_that_the_error_would_leave() -> None:
    rng = np.random.default_rng(0)
    for _ in range(80):
        width = int(rng.integers(2, 9))
        x = rng.normal(size=(60, width)) * rng.choice([0.05, 1.0], width) + rng.normal(size=(60, 1))
        y = x @ rng.normal(size=width) + rng.normal(size=60)
        low = np.where(rng.uniform(size=width) < 0.7, 0.0, -np.inf)
        high = np.where(rng.uniform(size=width) < 0.3, 0.5, np.inf)
        found = solve(x.T @ x, x.T @ y, low, high)
        best = lsq_linear(x, y, (low, high), tol=1e-12).x
        assert np.all((found >= low) & (found <= high))
        assert np.sum((y - x @ found) ** 2) <= np.sum((y - x @ best) ** 2) * (1 + 1e-6)

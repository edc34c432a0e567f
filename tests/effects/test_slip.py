"""Slip elements against the plain rule: each step added, the sum limited."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.effects.algebra import stop_operator


@pytest.mark.parametrize("seed", range(4))
def test_runs_of_one_direction_slip_as_their_steps_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.round(np.cumsum(rng.choice([0.0, 1.0, -1.0], 300) * rng.exponential(size=300)), 1)
    z, last, out = 0.3, float(angle[0]) - 0.7, []
    for at in angle.tolist():
        z = min(max(z + (at - last) / 1.7, -1.0), 1.0)
        last = at
        out.append(z)
    whole, state = stop_operator(angle, 1.7, (float(angle[0]) - 0.7, 0.3))
    assert whole == pytest.approx(out, abs=1e-12) and state == pytest.approx((last, z))
    first, between = stop_operator(angle[:113], 1.7, (float(angle[0]) - 0.7, 0.3))
    rest, _ = stop_operator(angle[113:], 1.7, between)
    assert [*first, *rest] == pytest.approx(out, abs=1e-12)

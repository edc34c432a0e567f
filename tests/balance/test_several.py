"""What several recordings say of each other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from edge_daemon.balance.several import foretold, told_apart

SWING = np.sin(np.arange(2000) / 50.0)


def recording(degC: float, size: float = 1.0) -> Any:
    extra = {"temperature_degC": degC + 0.1 * SWING, "current_in_A": SWING}
    return SimpleNamespace(
        motion=SimpleNamespace(extra=extra, theta_out_rad=size * SWING, velocity_out_rad_s=size * np.gradient(SWING))
    )


@pytest.mark.parametrize(
    ("made", "apart", "told"),
    [
        ([recording(20.0), recording(20.05)], (), True),
        ([recording(5.0), recording(40.0)], (0, 1), False),
        ([recording(20.0), recording(40.0), recording(5.0)], (2, 1), False),
        ([recording(5.0), recording(40.0), recording(5.0), recording(40.0)], (0, 1), True),
        ([recording(20.0), recording(20.0, 0.01)], (), False),
        ([recording(20.0), recording(20.0, 0.01), recording(20.0)], (), True),
    ],
)
def test_recordings_foretell_each_other_where_the_rest_reach_as_far(
    made: list[Any], apart: tuple[int, ...], told: bool
) -> None:
    """A small motion foretells no large one, nor a warm gear a cold one."""
    assert told_apart(made) == apart
    assert foretold(made) is told

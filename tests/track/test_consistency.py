"""An amplitude that moves: the doubt of it grows as soon as the data contradict it, and not before."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.motion.noise_level import compress
from edge_daemon.track.consistency import SPANS_S, Drift
from edge_daemon.track.recursive import AmplitudeFilter

BLOCK_S, ROWS = 0.3, 30
START = 1e5


def followed(rate_per_s: float, blocks: int, seed: int, watched: bool) -> list[float]:
    """Errors over sd, block by block, of a spring that softens after 100 blocks; one second tells it to 25."""
    rng, drift = np.random.default_rng(seed), Drift(*SPANS_S)
    filt = AmplitudeFilter(np.array([START]), np.array([START]), np.array([1.67]))
    off = []
    for i in range(blocks):
        truth = START - rate_per_s * BLOCK_S * max(i - 100, 0)
        column = rng.normal(size=(ROWS, 1))
        block = compress(column, column[:, 0] * truth + 250.0 * rng.normal(size=ROWS))
        filt.update(block, 250.0, BLOCK_S)
        moved, learned = (float(row[0]) for row in filt.step)
        before = learned + float(filt.sd[0] / filt.scale[0]) ** 2
        if watched and (lacking := drift.follow(moved, learned, before, 1.0, BLOCK_S)):
            filt.forget(np.array([lacking]))
        off.append(abs(float(filt.value[0]) - truth) / float(filt.sd[0]))
    return off


@pytest.mark.parametrize("rate_per_s", [16.0, 50.0, 160.0])
def test_a_spring_that_softens_is_followed_within_its_sd(rate_per_s: float) -> None:
    late = [row for seed in range(5) for row in followed(rate_per_s, 200, seed, True)[125:]]
    assert np.mean(np.array(late) < 5.0) > 0.97
    assert np.median(followed(rate_per_s, 200, 0, False)[125:]) > 8.0


def test_a_spring_that_keeps_still_gets_no_doubt() -> None:
    same = sum(followed(0.0, 400, seed, True) == followed(0.0, 400, seed, False) for seed in range(10))
    assert same >= 9

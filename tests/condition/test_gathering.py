"""Blocks joined to longer ones lose nothing and invent nothing."""

import numpy as np

from edge_daemon.condition.gathering import Gathering
from edge_daemon.records import Block, Flaw

RATE_HZ, SIZE = 1000.0, 100


def block(start_s, channels=("a", "b"), flaw=0):
    samples = start_s + np.arange(SIZE) / RATE_HZ
    values = {name: samples + 1000.0 * i for i, name in enumerate(channels)}
    flaws = {name: np.full(SIZE, flaw, np.uint8) for name in channels}
    return Block("joint", round(10 * start_s), start_s, RATE_HZ, values, flaws)


def gathered(blocks, span_s):
    gathering = Gathering(span_s)
    return [row for one in blocks for row in gathering.push(one)]


def test_every_sample_comes_once_and_at_its_time():
    flaws = (0, Flaw.RANGE, 0, 0, Flaw.FROZEN, 0)
    rows = gathered([block(100 + 0.1 * i, flaw=flaw) for i, flaw in enumerate(flaws)], 0.3)
    assert [row.size for row in rows] == [300, 300] and [row.sequence for row in rows] == [1002, 1005]
    for row in rows:
        np.testing.assert_allclose(row.values["a"], row.time_s, atol=1e-9)
        np.testing.assert_allclose(row.values["b"], row.time_s + 1000.0, atol=1e-9)
    np.testing.assert_array_equal(rows[1].flaws["a"], np.repeat(np.uint8(flaws[3:]), SIZE))


def test_what_does_not_follow_ends_what_was_held():
    after_a_gap = gathered([block(0.0), block(0.1), block(0.35), block(0.45), block(0.55)], 0.3)
    assert [(row.start_s, row.size) for row in after_a_gap] == [(0.0, 200), (0.35, 300)]
    lost_channel = gathered([block(0.0), block(0.1, ("a",)), block(0.2, ("a",)), block(0.3, ("a",))], 0.3)
    assert [(row.start_s, sorted(row.values)) for row in lost_channel] == [(0.0, ["a", "b"]), (0.1, ["a"])]


def test_a_long_block_passes_as_it_is():
    one = block(0.0)
    assert gathered([one], 0.05) == [one]

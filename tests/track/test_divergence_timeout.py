"""How long a motion that tells no stiffness is listened to before all is learned anew."""

import pytest

from edge_daemon.track.validity import GROWN, LONGEST_PATIENCE_S, PATIENCE_S, DivergenceTimeout

BLOCK_S, POWER, NOISE = 0.5, 1.0, 0.9


def ends_after(patience, most_s=2 * LONGEST_PATIENCE_S):
    """Seconds of a motion in the noise until it ends; None for not at all."""
    for i in range(round(most_s / BLOCK_S)):
        if patience.ends(BLOCK_S, POWER, NOISE, NOISE):
            patience.renew(False)
            return (i + 1) * BLOCK_S
    return None


def test_each_wait_is_twice_the_last_until_a_stiffness_is_told():
    patience = DivergenceTimeout()
    waits = [ends_after(patience) for _ in range(7)]
    expected = [min(PATIENCE_S * 2**i, LONGEST_PATIENCE_S) for i in range(7)]
    assert waits == pytest.approx(expected, abs=BLOCK_S)
    patience.renew(True)
    assert ends_after(patience) == pytest.approx(PATIENCE_S, abs=BLOCK_S)


def test_a_motion_that_grows_is_listened_to_anew_at_once():
    patience = DivergenceTimeout()
    assert not any(patience.ends(BLOCK_S, POWER, NOISE, NOISE) for _ in range(5))
    assert not patience.ends(BLOCK_S, 0.9 * GROWN * POWER, NOISE, NOISE)
    assert patience.ends(BLOCK_S, 1.1 * GROWN * POWER, NOISE, NOISE)


def test_more_left_than_there_is_ends_it_where_there_is_more_than_noise():
    assert DivergenceTimeout().ends(BLOCK_S, 10 * NOISE, 11 * NOISE, NOISE)
    assert not DivergenceTimeout().ends(BLOCK_S, 10 * NOISE, 9 * NOISE, NOISE)
    assert not DivergenceTimeout().ends(BLOCK_S, 2 * NOISE, 11 * NOISE, NOISE)

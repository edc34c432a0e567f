"""The detector of sudden changes against sums simulated here, at the same rate of false alarms."""

import math

import numpy as np
import pytest

from edge_daemon.track.change import FALSE_ALARM_S, SHIFT, ChangeEvidence, StiffnessChange, threshold

STIFFNESS, SD = 1e5, 0.0
BLOCK_S = 0.1
FALSE_ALARM_BLOCKS = FALSE_ALARM_S / BLOCK_S
SEED = 20261122


def energy_of(information):
    """Of a block's stiffness column, so that a change of SHIFT has this Kullback-Leibler information."""
    return 2 * information / (SHIFT * STIFFNESS) ** 2


def scores(rng, count, energy, change=0.0):
    """(n,) column times innovation over its variance, for innovation = column change K + noise."""
    return rng.normal(size=count) * math.sqrt(energy) + energy * change * STIFFNESS


def seen(score, energy):
    """A block whose innovation is all along the stiffness column: what else it holds is as expected."""
    return ChangeEvidence(score, energy, score**2 / energy, 1, BLOCK_S)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated():
    rng = np.random.default_rng(SEED)
    for information in (0.02, 0.9):
        energy, watch = energy_of(information), StiffnessChange()
        blocks = 6 * int(FALSE_ALARM_BLOCKS)
        alarms = sum(watch.follow(seen(s, energy), STIFFNESS, SD) != 0 for s in scores(rng, blocks, energy).tolist())
        assert 1 <= alarms <= 15, (information, alarms)  # six expected; Poisson, 99.7 %


def delay_of(rng, energy, change):
    """Blocks from a change to its notice, and which way."""
    watch = StiffnessChange()
    for s in scores(rng, 300, energy).tolist():
        watch.follow(seen(s, energy), STIFFNESS, SD)
    for i, s in enumerate(scores(rng, 5000, energy, change).tolist()):
        found = watch.follow(seen(s, energy), STIFFNESS, SD)
        if found:
            return i + 1, found
    return math.inf, 0


def simulated_optimum(rng, information, alarm_blocks):
    """Mean delay of a one-sided CUSUM of unit Gaussians whose threshold is found by simulated false alarms."""
    drift = math.sqrt(2 * information)

    def run_length(threshold, mean, runs):
        total = np.zeros(runs)
        alive = np.ones(runs, dtype=bool)
        length = np.zeros(runs)
        for _ in range(int(20 * alarm_blocks)):
            x = rng.normal(mean, 1.0, runs)
            total = np.maximum(0.0, total + drift * x - drift**2 / 2)
            length += alive
            alive &= total < threshold
            if not alive.any():
                break
        return float(length.mean())

    low, high = 1.0, 12.0
    for _ in range(9):
        middle = (low + high) / 2
        low, high = (middle, high) if run_length(middle, 0.0, 200) < alarm_blocks else (low, middle)
    return run_length(high, drift, 2000), high


def test_threshold_formula_against_simulated_run_lengths():
    rng = np.random.default_rng(SEED)
    information, alarm_blocks = 0.5, 300
    stated = threshold(information, alarm_blocks / 2)  # the formula counts two sums, the simulation runs one
    _, found = simulated_optimum(rng, information, alarm_blocks)
    assert abs(stated - found) < 0.35


def test_delay_is_that_of_the_information_and_the_sign_is_right():
    rng = np.random.default_rng(SEED)
    information = 0.5
    energy = energy_of(information)
    found = [delay_of(rng, energy, -SHIFT) for _ in range(200)]
    assert {which for _, which in found} == {-1}
    optimal = math.log(FALSE_ALARM_BLOCKS * information) / information  # Lorden: threshold over information
    assert np.mean([blocks for blocks, _ in found]) < 1.15 * optimal
    assert all(which == 1 for _, which in (delay_of(rng, energy, SHIFT) for _ in range(20)))


def test_nothing_is_told_against_a_stiffness_not_yet_known():
    rng = np.random.default_rng(SEED)
    energy, watch = energy_of(0.5), StiffnessChange()
    unsure = SHIFT * STIFFNESS
    found = [watch.follow(seen(s, energy), STIFFNESS, unsure) for s in scores(rng, 100, energy, -SHIFT).tolist()]
    assert not any(found)


def test_what_the_estimate_has_followed_meanwhile_counts_too():
    """The sum has the drift of the whole change although the estimate has taken half of it up."""
    energy, watch = energy_of(0.05), StiffnessChange()
    after = (1 - SHIFT) * STIFFNESS
    for i in range(1000):
        followed = STIFFNESS * (1 - SHIFT * min(1.0, 0.02 * i))
        if watch.follow(seen(energy * (after - followed), energy), followed, SD):
            break
    else:
        i = 1000
    assert i < 1.3 * (math.log(2 * FALSE_ALARM_BLOCKS * 0.05) / 0.05)


def test_what_another_stiffness_does_not_mend_is_no_change_of_it():
    """An innovation of which the stiffness column holds a tenth: a motion has brought out what the model lacks."""
    energy, watch = energy_of(0.5), StiffnessChange()
    score = -5 * SHIFT * STIFFNESS * energy
    blocks = [ChangeEvidence(score, energy, 10 * score**2 / energy, 9, BLOCK_S)] * 50
    assert not any(watch.follow(block, STIFFNESS, SD) for block in blocks)
    watch = StiffnessChange()
    assert any(watch.follow(seen(score, energy), STIFFNESS, SD) for _ in range(5))

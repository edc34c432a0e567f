"""The Cramer-Rao bounds of the bench against a Fisher matrix built from transfer functions, in closed form.

With N = K + i w B and D = N - J w^2 the output answers by N / D; by stiffness its derivative is -J w^2 / D^2, by
damping i w times that.
"""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import compiled_joint
import cramer_rao

JOINT = rig.Joint(out_bits=20, kinematic_pp=1e-5)
PATH = rig.Path(((5.5, 0.4), (9.0, 0.4), (13.5, 0.4)), (0.5, 0.3), 2, 4.0)


def closed_form():
    """Name -> (n,) derivative of the output angle."""
    n = round(PATH.seconds * rig.FINE_HZ)
    every = round(rig.FINE_HZ / rig.RATE_HZ)
    t = np.arange(n) / rig.FINE_HZ
    referred = PATH.angle(t)
    motor = JOINT.ratio * referred
    w = 2 * math.pi * np.fft.rfftfreq(n, 1 / rig.FINE_HZ)
    top = JOINT.stiffness + 1j * w * JOINT.damping
    bottom = top - JOINT.inertia * w**2

    def through(signal, transfer):
        return np.fft.irfft(np.fft.rfft(signal) * transfer, n)[::every]

    drive = referred + rig.kinematic(JOINT, motor)
    bend = -JOINT.inertia * w**2 / bottom**2
    rows = {"stiffness": through(drive, bend), "damping": through(drive, 1j * w * bend)}
    for order in (1, 2, 4):
        rows[f"sine_{order}"] = through(np.sin(order * motor), top / bottom)
        rows[f"cosine_{order}"] = through(np.cos(order * motor), top / bottom)
    rows["zero"] = np.ones(n // every)
    rows["ratio"] = -through(referred, top / bottom) / JOINT.ratio
    return rows


def test_derivatives_by_differences_are_the_transfer_functions_own():
    stated = cramer_rao.derivatives(JOINT, PATH, rig.linear)
    for name, column in closed_form().items():
        off = np.sqrt(np.mean((stated[name] - column) ** 2) / np.mean(column**2))
        assert off < 2e-3, (name, off)


def test_bounds_are_the_inverse_of_that_fisher_matrix():
    rows = closed_form()
    columns = np.column_stack(list(rows.values()))
    steps = np.array([2 * math.pi / 2**JOINT.in_bits / JOINT.ratio, 2 * math.pi / 2**JOINT.out_bits])
    variance = float(steps @ steps) / 12  # the motor encoder's share is a hundredth of it, wherever it stands
    scale = np.linalg.norm(columns, axis=0)
    covariance = np.linalg.inv((columns / scale).T @ (columns / scale)) * variance / np.outer(scale, scale)
    sd = dict(zip(rows, np.sqrt(np.diag(covariance)), strict=True))
    stated = cramer_rao.bounds(JOINT, PATH, rig.linear)
    for name in ("stiffness", "damping", "ratio"):
        assert abs(stated[name] / sd[name] - 1) < 1e-2, name


def test_least_squares_in_coloured_noise_scatters_as_the_bound_says():
    """Weighed least squares with the covariance matrix of the noise, sample by sample: white of the output's encoder,
    and the motor's through the impulse response of the joint."""
    joint, n, rng = replace(JOINT, in_bits=13, damping=100.0), 400, np.random.default_rng(3)
    into, out = cramer_rao.steps_rad(joint)
    frequency = np.fft.rfftfreq(n, 1 / rig.RATE_HZ)
    w = 2 * math.pi * frequency
    top = joint.stiffness + 1j * w * joint.damping
    kernel = np.fft.irfft(np.where(frequency < 100.0, top / (top - joint.inertia * w**2), 0.0), n)
    through = np.array([np.roll(kernel, i) for i in range(n)]).T
    covariance = out**2 * np.eye(n) + into**2 * through @ through.T
    t = np.arange(n) / rig.RATE_HZ
    columns = np.column_stack([np.sin(2 * math.pi * f * t) for f in (20.0, 160.0)] + [rng.normal(size=n)])
    exact = np.linalg.inv(columns.T @ np.linalg.solve(covariance, columns))
    stated = cramer_rao.covariance_of(columns, cramer_rao.spectrum(joint, frequency, 100.0))
    assert np.sqrt(np.diag(stated)) == pytest.approx(np.sqrt(np.diag(exact)), rel=1e-6)
    white = cramer_rao.noise_rad(joint) / np.linalg.norm(columns[:, 1])
    assert math.sqrt(stated[1, 1]) < 0.7 * white < 0.7 * math.sqrt(stated[0, 0])


def test_a_straight_line_fit_reaches_the_bound_of_its_slope():
    """Independent of any matrix: the sd of a line's slope is sigma over the root of the summed squares."""
    rng = np.random.default_rng(7)
    travel = closed_form()["ratio"] * -JOINT.ratio
    travel = travel - travel.mean()
    noise = cramer_rao.noise_rad(JOINT)
    found = [np.polyfit(travel, noise * rng.normal(size=len(travel)), 1)[0] for _ in range(400)]
    alone = noise / math.sqrt(travel @ travel)
    assert abs(np.std(found) / alone - 1) < 0.1
    assert cramer_rao.bounds(JOINT, PATH, rig.linear)["ratio"] >= 0.999 * JOINT.ratio * alone


@pytest.mark.slow
def test_a_width_that_is_unknown_as_well_widens_the_bound_of_friction():
    joint, path = rig.Joint(out_bits=20, coulomb=0.5), rig.Path(seconds=5.0)
    given = cramer_rao.bounds(joint, path, compiled_joint.stepped)
    freed = cramer_rao.bounds(joint, path, compiled_joint.stepped, width=True)
    assert "reversal" in freed and "reversal" not in given
    assert freed["coulomb"] > 1.05 * given["coulomb"]


def test_the_compiled_joint_is_the_one_of_the_tests():
    joint, path = rig.Joint(coulomb=0.5), rig.Path(seconds=5.0)
    for fast, plain in zip(compiled_joint.stepped(joint, path), rig.stepped(joint, path), strict=True):
        assert np.abs(fast - plain).max() < 1e-14

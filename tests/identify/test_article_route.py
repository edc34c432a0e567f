"""The articles' differences and averages against calculus, and their bias against what the algebra says it must be."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.motion import simulated_joint as rig

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
import article_route as route
from article_route import ArticleRouteError

RATE_HZ = 1000.0


def test_differences_and_averages_weaken_a_sine_as_their_transfer_functions_say() -> None:
    t = np.arange(4000) / RATE_HZ
    w, width = 2 * math.pi * 20.0, 11
    seen = route.kinematics(np.zeros(len(t)), np.sin(w * t), 100.0, RATE_HZ, width)
    differences = (math.sin(w / RATE_HZ) / (w / RATE_HZ)) ** 2
    average = math.sin(width * w / RATE_HZ / 2) / (width * math.sin(w / RATE_HZ / 2))
    assert np.ptp(seen.acceleration_out_rad_s2) / 2 == pytest.approx(w**2 * differences * average, rel=3e-3)
    assert np.ptp(seen.twist_rate_rad_s) / 2 == pytest.approx(w * math.sqrt(differences), rel=3e-3)
    assert np.ptp(seen.twist_rad) / 2 == pytest.approx(1.0, rel=3e-3)


def test_on_exact_slow_angles_it_finds_the_stiffness() -> None:
    joint = rig.Joint(kinematic_pp=0.0)
    theta_in, theta_out = rig.linear(joint, rig.Path(tones=((2.0, 0.8),), sweep=(0.5, 1.0), seconds=10.0))
    seen = route.kinematics(theta_in, theta_out, joint.ratio, RATE_HZ, 3)
    found = route.stiffness(seen, joint.inertia)
    assert found.stiffness_Nm_per_rad == pytest.approx(joint.stiffness, rel=1e-3)


def test_noise_of_the_twist_pulls_it_down_and_the_mean_of_cycles_gives_most_back() -> None:
    joint = rig.Joint(kinematic_pp=0.0)
    path = rig.Path(tones=((5.0, 1.2), (7.0, 1.2)), sweep=(1.0, 0.3), seconds=40.0)
    theta_in, theta_out = rig.linear(joint, path)
    noise = 3e-5 * np.random.default_rng(1).normal(size=len(theta_out))
    twist_power = float(np.var(theta_in / joint.ratio - theta_out))
    seen = route.kinematics(theta_in, theta_out + noise, joint.ratio, RATE_HZ, 25)
    plain = route.stiffness(seen, joint.inertia)
    exact = route.stiffness(route.kinematics(theta_in, theta_out, joint.ratio, RATE_HZ, 25), joint.inertia)
    attenuation = twist_power / (twist_power + float(np.var(noise)))
    assert plain.stiffness_Nm_per_rad == pytest.approx(exact.stiffness_Nm_per_rad * attenuation, rel=0.02)
    cycles = route.stiffness_of_cycles(seen, joint.inertia, 1000)
    assert abs(cycles.stiffness_Nm_per_rad / exact.stiffness_Nm_per_rad - 1) < (1 - attenuation) / 10


def test_an_average_that_would_shift_in_time_is_refused() -> None:
    with pytest.raises(ArticleRouteError, match="odd"):
        route.moving_average(np.zeros(10), 4)
    with pytest.raises(ArticleRouteError, match="whole cycles"):
        seen = route.ArticleMotion(np.zeros(100), np.zeros(100), np.zeros(100))
        route.stiffness_of_cycles(seen, 0.05, 60)

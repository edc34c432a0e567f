"""Friction does not feel the sensors' noise: it would forget where it was."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.balance.quiet_input import quiet_filter
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit

RATE_HZ, RATIO = 1000.0, 100.0
STIFFNESS, FRICTION_NM, PRESLIDING_RAD = 1.2e4, 0.7, 2e-5
DAMPING, RUB_RAD_S = 9.0, 1e-3
TIME_S = np.arange(20_000) / RATE_HZ
TORQUE_NM = 9.0 * np.sin(3.1 * TIME_S) + 4.0 * np.sin(11.3 * TIME_S) + 1.0 * np.sin(61.0 * TIME_S)


def slipping_twist(torque_Nm: np.ndarray) -> np.ndarray:
    """(n,) of a spring beside bristles (Dahl 1968), step by step as the torque grows and falls."""
    twist, bristle, out = 0.0, 0.0, np.empty(len(torque_Nm))
    for i, change in enumerate(np.diff(torque_Nm, prepend=0.0)):
        for part in np.full(4, change / 4):
            free = 1.0 - math.copysign(1.0, part) * bristle
            step = part / (STIFFNESS + FRICTION_NM / PRESLIDING_RAD * free)
            twist, bristle = twist + step, bristle + step / PRESLIDING_RAD * free
        out[i] = twist
    return out


def test_bristles_keep_their_numbers_beside_a_noisy_sensor() -> None:
    """Encoder and sensor err by a fiftieth of the presliding each sample."""
    rng, angle, twist = np.random.default_rng(3), 0.4 * np.sin(0.9 * TIME_S), slipping_twist(TORQUE_NM)
    columns = {
        "theta_in_rad": RATIO * (angle + twist),
        "theta_out_rad": angle + 4.5e-7 * rng.normal(size=len(angle)),
        "torque_out_Nm": TORQUE_NM + 0.06 * rng.normal(size=len(angle)),
    }
    model = Model("torsion", RATIO, math.nan, tuple(map(ModelEffect, ("linear_stiffness", "dahl_friction"))))
    found = fit([SimpleNamespace(time_s=TIME_S, columns=columns)], model)
    assert found.solution.rmse < 1.5 * found.floor
    friction, presliding = (found.model.value("dahl_friction", name) for name in ("friction", "presliding"))
    assert (friction, presliding) == pytest.approx((FRICTION_NM, PRESLIDING_RAD), rel=0.05)


def rubbing_twist(torque_Nm: np.ndarray, parts: int = 4) -> np.ndarray:
    """(n,) of a spring and a damper beside dry friction of the twist rate, each part of a step by Newton's method."""
    twist, rate, out, step_s = 0.0, 0.0, np.empty(len(torque_Nm)), 1 / RATE_HZ / parts
    before = np.concatenate((torque_Nm[:1], torque_Nm[:-1]))
    for i in range(len(torque_Nm)):
        for share in (np.arange(parts) + 1) / parts:
            torque = before[i] + share * (torque_Nm[i] - before[i]) - STIFFNESS * twist
            for _ in range(6):
                dry = math.tanh(rate / RUB_RAD_S)
                left = torque - (STIFFNESS * step_s + DAMPING) * rate - FRICTION_NM * dry
                slope = STIFFNESS * step_s + DAMPING + FRICTION_NM * (1 - dry**2) / RUB_RAD_S
                change = left / slope
                rate += math.copysign(min(abs(change), 2 * RUB_RAD_S), change) if abs(rate) < 4 * RUB_RAD_S else change
            twist += rate * step_s
        out[i] = twist
    return out


@pytest.mark.slow
def test_dry_friction_is_driven_by_all_that_the_sensor_reads() -> None:
    """It forgets noise, and turns round as quickly as the torque does: what a quiet torque lost left three floors of
    the exact model, with a friction of nine tenths."""
    rng, angle = np.random.default_rng(3), 0.4 * np.sin(0.9 * TIME_S)
    hiss = np.fft.rfft(rng.normal(size=len(angle)))
    hiss[np.fft.rfftfreq(len(angle), 1 / RATE_HZ) > 150.0] = 0.0  # twenty times the sensor's noise, below thirty
    waves = 0.45 * np.fft.irfft(hiss, len(angle))
    twist = rubbing_twist(TORQUE_NM + waves)
    columns = {
        "theta_in_rad": RATIO * (angle + twist),
        "theta_out_rad": angle + 2.5e-6 * rng.normal(size=len(angle)),
        "torque_out_Nm": TORQUE_NM + waves + 0.1 * rng.normal(size=len(angle)),
    }
    names = ("linear_stiffness", "viscous_damping", "coulomb_friction")
    found = fit(
        [SimpleNamespace(time_s=TIME_S, columns=columns)],
        Model("torsion", RATIO, math.nan, tuple(map(ModelEffect, names))),
    )
    assert found.solution.rmse < 1.3 * found.floor
    assert found.model.value("coulomb_friction", "friction") == pytest.approx(FRICTION_NM, rel=0.03)


def test_what_lies_above_the_motion_is_cut_off_and_the_motion_is_not() -> None:
    noise = 1e-2
    seen = TORQUE_NM + noise * np.random.default_rng(1).normal(size=len(TORQUE_NM))
    quiet = quiet_filter(seen, noise, RATE_HZ)
    assert quiet is not None
    inside = slice(300, -300)
    assert np.sqrt(np.mean((quiet(seen) - TORQUE_NM)[inside] ** 2)) < 0.4 * noise
    assert np.abs((quiet(TORQUE_NM) - TORQUE_NM)[inside]).max() < 0.01


def test_a_motion_that_reaches_high_is_left_as_it_is() -> None:
    loud = np.random.default_rng(2).normal(size=4000)
    quiet = quiet_filter(loud, 1e-3, RATE_HZ)
    assert quiet is not None and quiet(loud) == pytest.approx(loud, abs=0.02)
    assert quiet_filter(loud, 0.0, RATE_HZ) is None
    assert quiet_filter(loud[:500], 1e-3, RATE_HZ) is None

"""A drive with something from outside in its current: what no effect removes and the clock explains is not adequate."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.compare import compare
from edge_daemon.explain.diagnose import diagnose
from tests.explain.simulated_drives import RATIO, Arm, record

MODEL = Model("drive", 100.0, math.nan, (ModelEffect("inertia"), ModelEffect("viscous_friction")))
TONE_HZ = 17.3


def recording(tone: float) -> SimpleNamespace:
    """Newton's law with viscous friction along four tones, 20 s at 500 Hz, and a `tone` [A] from outside."""
    rng = np.random.default_rng(6)
    t = np.arange(10_000) / 500.0
    angle, current = np.zeros_like(t), tone * np.sin(2 * np.pi * TONE_HZ * t)
    for hz in (0.31, 1.1, 2.9, 6.1):
        w, p = 2 * np.pi * hz, rng.uniform(0, 6.28)
        angle += 0.5 / w * np.sin(w * t + p)
        current += 0.5 * (0.4 * np.cos(w * t + p) - 0.08 * w * np.sin(w * t + p))
    read = angle + rng.normal(0, 1e-7, len(t))
    columns = {"theta_out_rad": read, "current_in_A": current + rng.normal(0, 0.01, len(t))}
    return SimpleNamespace(time_s=t, columns=columns)


@pytest.mark.slow
@pytest.mark.parametrize(("tone", "verdict"), [(0.0, "adequate"), (0.3, "unexplained")])
def test_only_a_drive_without_a_tone_from_outside_is_adequate(tone: float, verdict: str) -> None:
    found = diagnose([recording(tone)], MODEL)
    assert found.verdict == verdict
    if tone:
        assert found.where[0].axis == "time" and f"{TONE_HZ:.3g}" in found.where[0].detail


def warming(factor: str) -> SimpleNamespace:
    """The same joint whose friction, or whose motor, changes as it warms: a third along the recording."""
    made = recording(0.0)
    warmth = 1 - np.exp(-made.time_s / 8.0)
    speed = np.gradient(made.columns["theta_out_rad"], made.time_s)
    friction = 0.25 * np.tanh(speed / 0.01)
    current = made.columns["current_in_A"] + friction * (1 if factor == "torque" else 1 + warmth)
    current *= 1 + 0.3 * warmth if factor == "torque" else 1
    return SimpleNamespace(time_s=made.time_s, columns={**made.columns, "current_in_A": current})


@pytest.mark.parametrize("factor", ["speed", "torque"])
def test_what_changes_along_a_recording_is_told_with_what_it_changes(factor: str) -> None:
    """Alone neither tells anything, and the residual's own past, which it always tells most, names no physics."""
    model = Model("drive", RATIO, math.nan, (*MODEL.effects, ModelEffect("coulomb_friction")))
    first, *_, last = compare([warming(factor)], model).where
    assert first.axis == f"{factor} x time" and first.share > 0.8
    assert last.axis == "lag" and last.share > 0.2


@pytest.mark.slow
def test_a_slow_wave_of_the_output_is_told_beside_a_faster_one() -> None:
    """Of five waves per turn the motion passes 1.7: its broad line hides in those of its neighbours."""
    plain = Model("drive", RATIO, math.nan, (*MODEL.effects, ModelEffect("coulomb_friction")))
    found = diagnose([record(Arm(waves=(("out", 5.0, 1.0, 0.4), ("out", 15.0, 0.5, 1.0))), 1)], plain)
    first = found.candidates[0]
    assert found.verdict == "missing" and first.effect == "wave_generator_ripple"
    assert {name.split("_")[-2] for name in first.parameters if name.endswith("_output")} == {"5", "15"}
    assert first.nrmse_after < 1.5 * found.error.noise_floor_nrmse

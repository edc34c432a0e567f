"""Effects in the loop: their laws say what their columns say, and the loop balances."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))

from outside_laws import TORSION

from edge_daemon.effects.catalogue import CATALOGUE
from edge_daemon.effects.effect import Effect
from edge_daemon.effects.expression import user_effect
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.identify.fit import fit
from edge_daemon.identify.inloop import AngleSensitivity, SimulatedTwist, Spring, packed, simulated_twist, tangent
from edge_daemon.integrator.laws import Element
from edge_daemon.integrator.twist import followed
from edge_daemon.records import Motion
from edge_daemon.rig.recording import simulate

LAWFUL = [effect for effect in CATALOGUE.values() if effect.in_loop is not None]
LAWS = {law.name: law for law in TORSION}
RATE_HZ = 4000.0


def motion() -> Motion:
    t = np.arange(4000) / RATE_HZ
    twist = 2e-4 * np.sin(2 * np.pi * 3 * t) + 1e-4 * np.sin(2 * np.pi * 11 * t + 1)
    rate = 2e-4 * 6 * np.pi * np.cos(2 * np.pi * 3 * t) + 1e-4 * 22 * np.pi * np.cos(2 * np.pi * 11 * t + 1)
    still = np.zeros(len(t))
    return Motion(RATE_HZ, 100.0, t, still, still, twist, rate, still, still, 5 * np.sin(7 * t), still + 30)


@pytest.mark.parametrize("effect", LAWFUL, ids=lambda effect: effect.name)
def test_a_law_is_the_same_torque_as_the_columns(effect: Effect) -> None:
    seen, amplitudes = motion(), np.linspace(0.5, 1.5, len(effect.amplitudes))
    columns, _ = effect.columns(seen, effect.start, None)
    assert effect.in_loop is not None
    law = effect.in_loop(effect.start, amplitudes.tolist())
    torque = followed(packed(law), seen.twist_rad, seen.twist_rate_rad_s, np.abs(seen.torque_Nm))
    expected = columns @ amplitudes
    assert torque == pytest.approx(expected, abs=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize(
    "text",
    [
        "a*tanh(twist_rate_rad_s/0.002) + (b*sin(3*time_s) + c*cos(3*time_s))*tanh(twist_rate_rad_s/0.002)",
        "-a*sign(twist_rate_rad_s)*abs(twist_rad)/1e-4",
    ],
)
def test_a_formula_that_is_dry_friction_of_the_twist_is_simulated(text: str) -> None:
    seen = motion()
    effect = user_effect(ModelEffect("law", {}, text), "torsion")
    amplitudes = np.linspace(0.5, 1.5, len(effect.amplitudes))
    assert effect.in_loop is not None and effect.factors is not None
    loads = np.column_stack((np.abs(seen.torque_Nm), effect.factors(seen)))
    torque = followed(packed(effect.in_loop({}, amplitudes.tolist())), seen.twist_rad, seen.twist_rate_rad_s, loads)
    written = effect.columns(seen, {}, None)[0] @ amplitudes
    turning = np.abs(seen.twist_rate_rad_s) < 5e-3  # the sign that is simulated is a steep tanh
    assert torque[~turning] == pytest.approx(written[~turning], abs=1e-3 * np.abs(written).max())


@pytest.mark.parametrize(
    "text",
    [
        "a*tanh(twist_rate_rad_s/0.002) + b*time_s",
        "a*tanh(twist_rate_rad_s/0.002)*twist_rate_rad_s",
        "a*tanh(twist_rate_rad_s/0.002)**2",
        "a*tanh(twist_rate_rad_s/0.002)*sin(k*time_s)",
        "a*tanh(twist_rate_rad_s/0.5)",
        "a*tanh(velocity_out_rad_s/0.002)",
    ],
)
def test_any_other_formula_is_taken_as_measured(text: str) -> None:
    effect = user_effect(ModelEffect("law", {}, text), "torsion")
    assert effect.in_loop is None and effect.factors is None
    assert user_effect(ModelEffect("law", {}, "a*sign(velocity_out_rad_s)"), "drive").in_loop is None


@pytest.mark.slow
def test_frictions_of_two_formulas_keep_their_own_factors() -> None:
    """Their order in the model says nothing."""
    law = LAWS["misaligned_friction"]
    seen = simulate(seconds=12.0, seed=5, laws=(law,))
    known: dict[str, float] = seen.truth["parameters"]  # type: ignore[assignment]
    base = (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping"))
    sign = "tanh(twist_rate_rad_s/0.001)"
    wave = f"a*sin({known['misaligned_friction.k']}*theta_out_rad)*{sign}"
    parts = ModelEffect("even", {}, f"a*{sign}"), ModelEffect("wave", {}, wave)
    for two in (parts, parts[::-1]):
        found = fit([seen], Model("torsion", known["ratio"], known["inertia_kg_m2"], (*base, *two)))
        size = known["misaligned_friction.size"]
        assert found.model.value("even", "a") == pytest.approx(size, rel=0.02)
        assert found.model.value("wave", "a") == pytest.approx(0.8 * size, rel=0.05)
        assert found.solution.rmse < 1.6 * found.floor


@pytest.mark.parametrize("effect", LAWFUL, ids=lambda effect: effect.name)
def test_the_simulated_twist_balances_the_torque(effect: Effect) -> None:
    """J d2phi/dt2 = push - K phi - B dphi/dt - law, checked by differences of the rate that came out."""
    j, k, b = 0.1, 2e4, 6.0
    n = round(RATE_HZ)
    push = 3 * np.sin(2 * np.pi * 5 * np.arange(n) / RATE_HZ)
    on = SimulatedTwist(4, 1 / RATE_HZ, push, np.abs(push), np.zeros(n), 0.0)
    assert effect.in_loop is not None
    law = effect.in_loop(effect.start, [0.3] * len(effect.amplitudes))
    quiet = Spring(0.0, k, b)  # massless: no observer, no memory of the rate
    by = simulated_twist(on, quiet, law, None)
    left = push - k * by.twist_rad - b * by.rate_rad_s - by.torque_Nm
    assert np.abs(left).max() < 1e-3
    assert np.isfinite(simulated_twist(on, Spring(j, k, b), law, None).twist_rad).all()


def stick_slip(seed: int, friction: float, stiffness: float, damping: float, inertia: float = 0.1) -> SimpleNamespace:
    """Set-valued dry friction by the time stepping of Moreau (1988) at 50 kHz: the twist rate is exactly zero or not.

    Prescribed motor motion; encoders of 17 bits at the input and 24 at the output."""
    rng = np.random.default_rng(seed)
    h, every = 2e-5, 50
    t = np.arange(round(12.5 / h)) * h
    tones = [(0.4, 1.0), (2.3, 0.4), (7.1, 0.3), (13.0, 0.2)]
    phase = rng.uniform(0, 6, len(tones))
    speed = np.sum([s * np.cos(2 * np.pi * f * t + p) for (f, s), p in zip(tones, phase, strict=True)], axis=0)
    angle = np.sum(
        [s / (2 * np.pi * f) * np.sin(2 * np.pi * f * t + p) for (f, s), p in zip(tones, phase, strict=True)], axis=0
    )
    push = (inertia * np.diff(speed) / h).tolist()
    twist, rate, seen = 0.0, 0.0, []
    lean, keep = inertia / h + damping / 2 + stiffness * h / 4, inertia / h - damping / 2 - stiffness * h / 4
    for drive in push:
        seen.append(twist)
        free = keep * rate + drive - stiffness * twist
        after = (free - friction if free > friction else free + friction if free < -friction else 0.0) / lean
        twist += h * (rate + after) / 2
        rate = after
    out = (angle[:-1] - np.array(seen))[25_000::every]
    into = 100 * angle[:-1][25_000::every]
    steps = 2 * np.pi / 2**17, 2 * np.pi / 2**24
    noisy = [np.round((a + rng.normal(0, 0.25 * q, len(a))) / q) * q for a, q in zip((into, out), steps, strict=True)]
    columns = {"theta_in_rad": noisy[0], "theta_out_rad": noisy[1]}
    return SimpleNamespace(time_s=np.arange(len(out)) / 1000.0, columns=columns)


@pytest.mark.slow
def test_stick_and_slip_is_fitted_to_the_noise_floor_with_honest_deviations() -> None:
    names = ("linear_stiffness", "viscous_damping", "coulomb_friction")
    model = Model("torsion", 100.0, 0.1, tuple(ModelEffect(name) for name in names))
    fitted = fit([stick_slip(2, 1.0, 2.5e4, 5.0)], model)
    assert fitted.nrmse < 1.2 * fitted.floor / fitted.problem.rms
    truths = {"linear_stiffness": 2.5e4, "viscous_damping": 5.0, "coulomb_friction": 1.0}
    for effect, truth in truths.items():
        row = next(iter(fitted.model.effect(effect).parameters.values()))  # type: ignore[union-attr]
        assert row.value == pytest.approx(truth, rel=0.06)
        assert abs(row.value - truth) < 4 * row.sd


def slipping(widths: list[float], torques: list[float], stiffness: float, damping: float) -> SimpleNamespace:
    """A spring, a damper and slipping springs beside them, by semi-implicit Euler steps at 50 kHz; encoders of 17 bits
    at the input and 24 at the output."""
    inertia, h, every = 0.1, 2e-5, 50
    rng = np.random.default_rng(4)
    t = np.arange(round(8.5 / h)) * h
    speed, angle = np.zeros(len(t)), np.zeros(len(t))
    for f, s, p in [(0.4, 0.9, 0.0), (2.3, 0.4, 1.0), (7.1, 0.3, 2.0), (13.0, 0.2, 4.0)]:
        speed += s * np.cos(2 * np.pi * f * t + p)
        angle += s / (2 * np.pi * f) * np.sin(2 * np.pi * f * t + p)
    twist, rate, seen = 0.0, 0.0, []
    slips = [0.0] * len(widths)
    for change in np.diff(speed).tolist():
        seen.append(twist)
        carried = sum(f * z / w for f, z, w in zip(torques, slips, widths, strict=True))
        rate += change - h / inertia * (stiffness * twist + damping * rate + carried)
        twist += h * rate
        slips = [min(max(z + h * rate, -w), w) for z, w in zip(slips, widths, strict=True)]
    kept = slice(round(0.5 / h), len(seen), every)
    out = angle[: len(seen)][kept] - np.array(seen)[kept]
    fine, coarse = 2 * np.pi / 2**24, 2 * np.pi / 2**17
    columns = {
        "theta_in_rad": np.round(100 * angle[: len(seen)][kept] / coarse + rng.normal(0, 0.25, len(out))) * coarse,
        "theta_out_rad": np.round(out / fine + rng.normal(0, 0.25, len(out))) * fine,
    }
    return SimpleNamespace(time_s=np.arange(len(out)) * h * every, columns=columns)


@pytest.mark.slow
def test_slipping_springs_of_any_widths_are_found() -> None:
    """Not each spring, of which the fit has more, but the torque that all carry at first loading."""
    widths, torques = [1.2e-5, 3e-5, 7e-5], [0.25, 0.35, 0.3]
    rows = ("linear_stiffness", "viscous_damping", "maxwell_slip_hysteresis")
    model = Model("torsion", 100.0, 0.1, tuple(ModelEffect(name) for name in rows))
    found = fit([slipping(widths, torques, 2.5e4, 6.0)], model)
    assert found.nrmse * found.problem.rms < 1.6 * found.floor
    spring, known = found.model.effects[0].parameters["stiffness"].value, found.model.effects[2].parameters
    sizes = [(known[f"torque_{i}"].value, known[f"width_{i}"].value) for i in range(1, 7)]
    for x in widths:
        truth = 2.5e4 * x + sum(f * min(x / w, 1.0) for f, w in zip(torques, widths, strict=True))
        assert spring * x + sum(f * min(x / w, 1.0) for f, w in sizes) == pytest.approx(truth, rel=0.02)


@pytest.mark.parametrize("effect", LAWFUL, ids=lambda effect: effect.name)
def test_tangents_are_what_differences_of_the_simulation_say(effect: Effect) -> None:
    n, k, b, inertia = 4000, 2e4, 6.0, 0.1
    push = 3 * np.sin(2 * np.pi * 5 * np.arange(n) / RATE_HZ) + 2 * np.sin(2 * np.pi * 17 * np.arange(n) / RATE_HZ)
    on = SimulatedTwist(4, 1 / RATE_HZ, push, np.abs(push), push / k, 0.0)
    assert effect.in_loop is not None
    amplitudes = [0.3] * len(effect.amplitudes)
    law = packed(effect.in_loop(effect.start, amplitudes))
    still = np.zeros((len(law), 4))
    bends = [AngleSensitivity((0.0, 1.0), still)]
    for i in range(len(law)):
        bends.append(AngleSensitivity((0.0, 0.0), np.where(np.arange(len(law))[:, None] == i, [1.0, 0, 0, 0], 0.0)))
    elements = [Element(int(row[0]), *row[1:]) for row in law]
    _, changes = tangent(on, Spring(inertia, k, b), elements, None, bends)
    for i, bend in enumerate(bends):
        step = 1e-5 * (b, *law[:, 1])[i] + 1e-12
        ends = []
        for side in (step, -step):
            spring = Spring(inertia, k, b + side * bend.spring[1])
            moved = law.copy()
            moved[:, 1:] += side * bend.elements
            ends.append(simulated_twist(on, spring, [Element(int(row[0]), *row[1:]) for row in moved], None).torque_Nm)
        difference = (ends[0] - ends[1]) / (2 * step)
        average = np.convolve(difference, [0.125, 0.25, 0.25, 0.25, 0.125], mode="same")[::4]
        error = changes[i, 2:-2] - average[2:-2]
        assert np.sqrt(np.mean(error**2)) <= 0.05 * np.sqrt(np.mean(average**2)) + 1e-12

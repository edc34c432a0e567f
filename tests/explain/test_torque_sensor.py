"""A gear beside a torque sensor whose encoders are not read at one instant, or whose teeth err."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.explain.add import add_effect
from edge_daemon.explain.diagnose import diagnose
from edge_daemon.identify.fit import fit

pytestmark = pytest.mark.slow

MODEL = Model("torsion", 100.0, math.nan, (ModelEffect("linear_stiffness"), ModelEffect("viscous_damping")))
FRICTIONS = {
    "encoder_skew+output_coulomb_friction",
    "output_coulomb_friction+output_viscous_friction",
}
"""The output's viscous friction and a skew are one curve, but for a sign of the damper's."""
STIFFNESS, DAMPING, INERTIA, RATIO, RATE_HZ, SECONDS = 2e4, 3.0, 0.08, 100.0, 1000.0, 20.0
OILED = 40.0
"""Damping of a gear that crosses its gap in some samples [N m s/rad]."""


def joint(
    seed: int, bits: int, skew_s: float = 0.0, error_rad: float = 0.0, off_centre_rad: float = 0.0
) -> SimpleNamespace:
    """Six tones, each with the twist that spring and damper give it; torque with 0.1 % of noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    omega = 2 * math.pi * np.array([0.37, 1.1, 2.9, 6.7, 13.1, 19.0]) * rng.uniform(0.9, 1.1, 6)
    speed = np.array([1.2, 0.8, 0.4, 0.25, 0.15, 0.1]) * rng.uniform(0.8, 1.2, 6)
    phase = rng.uniform(0, 6.28, 6)

    def tones(size: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.asarray((np.exp(1j * (np.outer(at, omega) + phase)) * size).real.sum(axis=1))

    bent = INERTIA * speed * omega / (STIFFNESS + 1j * omega * DAMPING)
    angle, torque = tones(-speed / omega, time_s), INERTIA * tones(speed * omega, time_s)
    motor = RATIO * tones(bent - speed / omega, time_s + skew_s)
    motor -= RATIO * error_rad * (np.sin(2 * motor + 0.3) + 0.4 * np.sin(motor + 1.0) + 0.3 * np.sin(4 * motor + 2.0))
    read = angle + off_centre_rad * np.sin(angle + 0.7)
    columns = {"torque_out_Nm": torque + 1e-3 * torque.std() * rng.normal(size=len(torque))}
    for name, true, step in (("theta_in_rad", motor, 2**-17), ("theta_out_rad", read, 2.0**-bits)):
        step *= 2 * math.pi
        columns[name] = np.rint(true / step + rng.normal(0, 0.25, len(true))) * step
    return SimpleNamespace(time_s=time_s, columns=columns)


def test_a_skew_at_20_bits_is_named_alone() -> None:
    """Only friction of the output does the same to first order: it may stand beside it."""
    found = diagnose([joint(2, 20, skew_s=2e-5)], MODEL)
    assert found.candidates[0].effect == "encoder_skew"
    assert {row.effect for row in found.candidates if row.probability > 0.05} <= {
        "encoder_skew",
        "output_viscous_friction",
    }
    assert found.candidates[0].nrmse_after < found.error.noise_floor_nrmse


def test_a_kinematic_error_at_24_bits_is_believed() -> None:
    first = diagnose([joint(2, 24, error_rad=5e-6)], MODEL).candidates[0]
    assert first.effect == "kinematic_error" and first.probability > 0.5


def test_what_looks_like_a_weight_beside_a_sensor_that_weighs_it_is_the_encoder() -> None:
    """Over less than half a turn the two are one function of the angle, and a weight is in the sensor's reading."""
    found = diagnose([joint(3, 24, off_centre_rad=1e-4)], MODEL)
    first = found.candidates[0]
    assert found.verdict == "missing" and first.effect == "encoder_eccentricity"
    assert first.confused_with == ("gravity_load",) and first.nrmse_after < found.error.noise_floor_nrmse


def bent(torque_Nm: np.ndarray, time_s: np.ndarray, zero_rad: float) -> SimpleNamespace:
    """A spring of 1e4 N m/rad that is twice as stiff beyond 20 N m, beside a torque sensor; encoders of 24 bits."""
    rng, size = np.random.default_rng(4), np.abs(torque_Nm)
    twist = np.sign(torque_Nm) * (np.minimum(size, 20.0) / 1e4 + np.maximum(size - 20.0, 0.0) / 2e4)
    angle, step = 0.4 * np.sin(0.9 * time_s), 2 * math.pi / 2**24
    read = {"theta_in_rad": RATIO * (angle + twist + zero_rad), "theta_out_rad": angle}
    columns = {name: np.rint(true / step + rng.normal(0, 0.3, len(true))) * step for name, true in read.items()}
    columns["torque_out_Nm"] = torque_Nm + 0.05 * rng.normal(size=len(torque_Nm))
    return SimpleNamespace(time_s=time_s, columns=columns)


TIME_S = np.arange(15_000) / 500.0
TONES = np.sin(3.1 * TIME_S) + 0.5 * np.sin(11.3 * TIME_S)


def test_zeros_that_differ_by_more_than_any_twist_hide_no_bend() -> None:
    """By a degree and a half: the torque passes zero, the twist does not."""
    found = diagnose([bent(80.0 * TONES, TIME_S, -0.026)], MODEL)
    assert found.candidates[0].effect == "piecewise_stiffness" and found.candidates[0].probability > 0.5
    assert found.candidates[0].nrmse_after < 1.5 * found.error.noise_floor_nrmse


def test_a_spring_of_pieces_leaves_no_less_than_the_sensors_do() -> None:
    """Of a gear that is loaded one way only it could take all of the stiffness, in whose units a simulated twist was
    compared."""
    joint = bent(60.0 + 20.0 * TONES, TIME_S, 0.0)
    added = add_effect(MODEL, "piecewise_stiffness", [joint])
    assert added.after.nrmse > 0.5 * added.after.noise_floor_nrmse


def test_noise_of_any_colour_is_no_law_that_is_missing() -> None:
    """A sensor that filters what it tells is quiet near half the sampling rate, where noise is heard otherwise."""
    read = joint(2, 22, error_rad=4e-5)
    torque = read.columns["torque_out_Nm"]
    noise = sosfiltfilt(butter(2, 60.0, fs=RATE_HZ, output="sos"), np.random.default_rng(5).normal(size=len(torque)))
    share = 0.01
    read.columns["torque_out_Nm"] = torque + share * torque.std() * noise / noise.std()
    found = diagnose([read], MODEL)
    assert found.verdict == "missing" and found.candidates[0].effect == "kinematic_error"
    assert 0.8 * share < found.error.noise_floor_nrmse < 1.3 * share


def test_friction_of_the_output_is_told_where_its_reversals_are_not_seen() -> None:
    """Without the sensor: the torque is that of the inertia, and dry friction of the twist imitates the reversals."""
    read = joint(2, 24)
    torque = read.columns.pop("torque_out_Nm")
    speed = np.gradient(read.columns["theta_out_rad"], read.time_s)
    friction = 0.5 * torque.std() * np.sign(speed) + 0.3 * torque.std() * speed / speed.std()
    read.columns["theta_in_rad"] = read.columns["theta_in_rad"] + RATIO * friction / STIFFNESS
    model = replace(MODEL, output_inertia_kg_m2=INERTIA)
    first = diagnose([read], model).candidates[0]
    assert first.effect in FRICTIONS and first.nrmse_after < 0.1 * first.nrmse_before
    larger = add_effect(model, first.effect, [read])  # the model has it, so that reversals are not judged by
    assert larger.after.nrmse < 0.5 * first.nrmse_after


def dragged(torque_Nm: np.ndarray, share: float, steps: int = 20) -> np.ndarray:
    """(n,) twist of spring and damper beside friction that is a share of the torque that passes them."""
    fine = np.interp(np.arange(len(torque_Nm) * steps) / steps, np.arange(len(torque_Nm)), torque_Nm).tolist()
    twist, at = np.empty(len(fine)), fine[0] / STIFFNESS
    for i, torque in enumerate(fine):
        left = torque - STIFFNESS * at
        at += math.copysign(max(abs(left) - share * abs(torque), 0.0), left) / (DAMPING * RATE_HZ * steps)
        twist[i] = at
    return twist[::steps]


def test_ripple_of_the_sensor_is_no_error_of_the_angle_beside_friction_of_the_load() -> None:
    """An error of the angle would move the twist that the friction slips by: held against the friction of the ripple's
    own twist it was named first, promised two noise floors and left ten."""
    rng = np.random.default_rng(5)
    time_s = np.arange(8000) / RATE_HZ
    out = sum(size * np.sin(2 * math.pi * f * time_s + f) for f, size in ((0.17, 0.7), (0.61, 0.2), (1.9, 0.02)))
    torque = 40.0 * np.sin(out + 0.3) + 0.9 * np.gradient(np.gradient(out, time_s), time_s)
    motor = RATIO * (out + dragged(torque, 0.05))
    ripple = 0.9 * np.sin(2 * motor + 0.3) + 0.5 * np.sin(4 * motor + 1.1)
    columns = {"torque_out_Nm": torque + ripple + 5e-3 * rng.normal(size=len(torque))}
    for name, true, step in (("theta_in_rad", motor, 2**-20), ("theta_out_rad", out, 2**-24)):
        step *= 2 * math.pi
        columns[name] = np.rint(true / step + rng.normal(0, 0.25, len(true))) * step
    found = diagnose([SimpleNamespace(time_s=time_s, columns=columns)], MODEL)
    first = found.candidates[0]
    assert first.effect == "load_dependent_friction+torque_ripple" and first.probability > 0.8


@pytest.mark.parametrize("begun_s", [0.0, 2.3, 4.1])
def test_a_recording_that_begins_in_motion_holds_what_slipped_before(begun_s: float) -> None:
    """An element that slips at 0.5 mrad was taken for one at rest: it left 44 noise floors."""
    rng = np.random.default_rng(8)
    time_s = np.arange(20_000) / 1000.0
    twist = 1e-3 * (np.sin(1.7 * time_s) + 0.7 * np.sin(4.3 * time_s + 1.0) - 0.7 * np.sin(1.0))
    z, slipped = 0.0, []
    for step in np.diff(twist, prepend=0.0).tolist():
        z = min(max(z + step / 5e-4, -1.0), 1.0)
        slipped.append(z)
    torque = STIFFNESS * twist + 4.0 * np.array(slipped)
    angle, size = 0.3 * np.sin(0.8 * time_s), 2 * math.pi * 2**-23
    read = {"theta_in_rad": RATIO * (angle + twist), "theta_out_rad": angle}
    columns = {name: np.rint(true / size + rng.normal(0, 0.3, len(true))) * size for name, true in read.items()}
    columns["torque_out_Nm"] = torque + 1e-3 * torque.std() * rng.normal(size=len(torque))
    kept = time_s >= begun_s
    recording = SimpleNamespace(time_s=time_s[kept], columns={name: row[kept] for name, row in columns.items()})
    fitted = fit([recording], MODEL.with_effect(ModelEffect("maxwell_slip_hysteresis")))
    assert fitted.solution.rmse < 1.2 * fitted.floor


def with_gap(half_gap_rad: float, skew_s: float, seed: int) -> SimpleNamespace:
    """Spring and damper beyond a gap, integrated; the motor is read later than the rest."""
    rng, step_s = np.random.default_rng(seed), 1e-4
    time_s = np.arange(round(SECONDS / step_s)) * step_s
    waves = ((0.31, 0.6), (1.3, 0.15), (3.1, 0.05))
    angle = sum(size * np.sin(2 * math.pi * hz * time_s + rng.uniform(0, 6.28)) for hz, size in waves)
    torque = 8.0 * INERTIA * np.gradient(np.gradient(angle, step_s), step_s)
    kept, twist, phi = math.exp(-step_s * STIFFNESS / OILED), np.zeros(len(torque)), 0.0
    for i, pull in enumerate((torque / STIFFNESS).tolist()):
        inside = min(max(phi, -half_gap_rad), half_gap_rad)
        rest = pull + inside
        phi = rest + (phi - rest) * kept if abs(phi) > half_gap_rad else phi + pull * step_s * STIFFNESS / OILED
        twist[i] = phi
    motor = np.interp(time_s + skew_s, time_s, RATIO * (angle + twist))
    motor -= RATIO * 3e-5 * np.sin(2 * motor + 0.3)
    columns = {"torque_out_Nm": torque, "theta_in_rad": motor, "theta_out_rad": angle}
    read = {name: column[::10] for name, column in columns.items()}
    read["torque_out_Nm"] = read["torque_out_Nm"] + 3e-3 * torque.std() * rng.normal(size=len(read["torque_out_Nm"]))
    for name, turn in (("theta_in_rad", 2**-19), ("theta_out_rad", 2**-22)):
        read[name] = np.rint(read[name] / (2 * math.pi * turn)) * 2 * math.pi * turn
    return SimpleNamespace(time_s=time_s[::10], columns=read)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_gap_beside_errors_of_the_angles_comes_to_rest(seed: int) -> None:
    """Each round moved the gap by a third of what was missing: it was told 15 % too wide, and beside encoders of an arm
    3.3 noise floors were left, for which a steady load was named."""
    model = MODEL
    for name in ("kinematic_error", "encoder_skew", "backlash"):
        model = model.with_effect(ModelEffect(name))
    fitted = fit([with_gap(8e-5, 1.8e-4, seed)], model)
    assert 0.9 < fitted.solution.rmse / fitted.floor < 1.2  # a delay of the sensor took a fifth of its own noise
    assert fitted.model.value("backlash", "half_gap") == pytest.approx(8e-5, rel=0.03)


def test_a_soft_joint_with_a_gap_is_compared_as_it_was_added() -> None:
    """A planetary gear, a fifteenth as stiff as a strain wave gear: `add` left 0.6 %, `compare` of that model 2.9 %."""
    rng, torque = np.random.default_rng(9), 5.0 * TONES
    twist = torque / 1300.0 + 1.1e-3 * np.tanh(torque / 0.05)
    angle, size = 0.4 * np.sin(0.9 * TIME_S), 2 * math.pi * 2**-19
    read = {"theta_in_rad": RATIO * (angle + twist), "theta_out_rad": angle}
    columns = {name: np.rint(true / size + rng.normal(0, 0.3, len(true))) * size for name, true in read.items()}
    speed = np.gradient(angle + twist, TIME_S)
    motor = torque + 0.6 * np.sign(speed) + 0.25 * speed + 0.02 * np.gradient(speed, TIME_S)
    columns["torque_in_Nm"] = (motor + 0.01 * rng.normal(size=len(torque))) / RATIO
    recording = SimpleNamespace(time_s=TIME_S, columns=columns)
    added = add_effect(MODEL, "backlash", [recording])
    assert added.helps
    assert fit([recording], added.model).nrmse == pytest.approx(added.after.nrmse, rel=0.05)

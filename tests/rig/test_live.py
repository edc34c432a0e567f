"""The live drive: the sensors' data hold the truth that the ready line states, however the time is cut."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.rig.live import live_drive


def angles(seed: int, cuts: list[float], **options: object) -> tuple[np.ndarray, np.ndarray, dict[str, object]]:
    drive = live_drive(seed, **options)  # type: ignore[arg-type]
    parts = [drive.advance(until_s) for until_s in cuts]
    inner, outer = (np.concatenate([getattr(part, name) for part in parts]) for name in ("counts_in", "counts_out"))
    return inner * (2 * np.pi / 2**17), outer * (2 * np.pi / 2**24), drive.truth


def test_ticks_of_any_length_give_the_same_samples() -> None:
    whole = live_drive(5).advance(0.5)
    drive = live_drive(5)
    parts = [drive.advance(until_s) for until_s in (0.0103, 0.2, 0.2001, 0.5)]
    np.testing.assert_allclose(np.concatenate([part.time_s for part in parts]), whole.time_s)
    np.testing.assert_allclose(np.concatenate([part.motor_torque_Nm for part in parts]), whole.motor_torque_Nm)


def test_the_stated_stiffness_damping_and_kinematic_error_explain_the_encoders() -> None:
    theta_in, theta_out, truth = angles(3, [20.0], effects=["kinematic_error"])
    parameters = truth["parameters"]
    assert isinstance(parameters, dict)
    rate = 1000.0
    phase = 2 * theta_in + parameters["kinematic_error.phase2_rad"]
    twist = theta_in / 100.0 - theta_out + parameters["kinematic_error.order2_rad"] * np.sin(phase)
    for order in (1, 4):
        size, at = (parameters[f"kinematic_error.{what}{order}_rad"] for what in ("order", "phase"))
        twist = twist + size * np.sin(order * theta_in + at)

    def smooth(x: np.ndarray, derivative: int) -> np.ndarray:
        """Band-limited to 150 Hz in the frequency domain, ends cut away by a window."""
        f = np.fft.rfftfreq(len(x), 1 / rate)
        window = np.hanning(len(x))
        assert derivative in (0, 1, 2)
        raw = [x, np.gradient(x) * rate, np.gradient(np.gradient(x)) * rate**2][derivative]
        response = np.sinc(2 * f / rate) ** derivative  # what central differences do to a sine
        spectrum = np.fft.rfft(raw * window) * (f < 150.0) / np.where(f < 150.0, response, 1.0)
        return np.fft.irfft(spectrum, len(x))

    torque = 0.05 * smooth(theta_out, 2)
    columns = np.column_stack((smooth(twist, 0), smooth(twist, 1)))
    stiffness, damping = np.linalg.lstsq(columns, torque, rcond=None)[0]
    assert stiffness == pytest.approx(1e5, rel=0.005)
    assert damping == pytest.approx(12.0, rel=0.03)
    left = torque - columns @ [stiffness, damping]
    assert left.std() < 0.03 * torque.std()


def test_wear_softens_the_gear_and_time_brings_it() -> None:
    drive = live_drive(3, wear_per_s=0.1)
    drive.advance(2.0)
    assert drive.wear == pytest.approx(0.2)
    assert drive.plant.stiffness_scale == pytest.approx(1.0 - 0.3 * 0.2)
    drive.wear = 5.0
    drive.advance(2.1)
    assert drive.wear == 1.0


def test_skipped_time_leaves_a_gap_and_nothing_else() -> None:
    drive = live_drive(3)
    drive.advance(0.1)
    drive.skip(0.4)
    after = drive.advance(0.6)
    assert after.time_s[0] == pytest.approx(0.501)
    assert len(after) == 100


def test_given_parameters_are_used_and_the_gear_warms_up() -> None:
    drive = live_drive(1, ["backlash"], parameters={"backlash.gap_rad": 3e-4})
    assert drive.truth["parameters"] == {"backlash.gap_rad": 3e-4}
    for second in range(1, 6):
        drive.advance(float(second))
    assert drive.housing.temperature_degC > 25.02


def test_what_the_motor_gives_is_lost_in_friction_or_leaves_at_the_output() -> None:
    """Energy of motor, rotor, gear and output over two seconds, from the drive's own torques and the truth's laws."""
    drive = live_drive(3)
    drive.advance(0.2)  # rung in
    level, width = 1.0, 1e-3
    given = lost = 0.0
    for tick in range(20, 220):
        part = drive.advance((tick + 1) / 100)
        time_s, _, rate = (x[-80:] for x in drive.recent)
        speed = drive.motion.course(part.time_s).speed
        given += float(part.motor_torque_Nm @ speed) * 1e-3
        motor = drive.motion.course(time_s).speed
        lost += float(12.0 * rate @ rate + level * rate @ np.tanh(rate / width)) * 1.25e-4
        lost += float((0.03 * np.tanh(motor) + 2e-4 * motor) @ motor) * 1.25e-4
    end = drive.motion.course(np.array([0.2, 2.2])).speed
    stored = 0.5 * 3e-5 * float(end[1] ** 2 - end[0] ** 2) + 0.5 * 0.05 * float(end[1] ** 2 - end[0] ** 2) / 1e4
    assert given == pytest.approx(lost + stored, rel=0.02)

"""What goes wrong with the simulated drive: each fault does what its row says, and a healthy twin tells the truth."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.errors import BadInput
from edge_daemon.rig.faults import FAULTS, follow, planned
from edge_daemon.rig.live import LiveDrive, Samples, live_drive

OUT_RAD, IN_RAD = 2 * np.pi / 2**24, 2 * np.pi / 2**17
BEGIN, END = 200, 300
"""[ms]: when the faults of these tests begin and end"""


def run(*faults: str, until_s: float = 0.5) -> tuple[Samples, LiveDrive]:
    """Half a second of the demonstration's drive, a tick every 10 ms."""
    drive = live_drive(seed=3)
    plan = [planned(text) for text in faults]
    parts = []
    for tick in range(1, round(until_s * 100) + 1):
        follow(plan, drive)
        parts.append(drive.advance(tick / 100))
    columns = (np.concatenate([getattr(part, name) for part in parts]) for name in Samples.__slots__)
    return Samples(*columns), drive


@pytest.fixture(scope="module")
def healthy() -> Samples:
    return run()[0]


def counts(samples: Samples, name: str) -> tuple[np.ndarray, float]:
    """Of the encoder that this fault is of, and its step."""
    return (samples.counts_in, IN_RAD) if name.endswith("_in") else (samples.counts_out, OUT_RAD)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_begins_when_told_and_is_visible_in_what_the_drive_tells(healthy: Samples, name: str) -> None:
    faulty, drive = run(f"{name}@0.2")
    shown = {field: np.asarray(getattr(faulty, field)) for field in Samples.__slots__}
    before = all(np.array_equal(x[:BEGIN], getattr(healthy, field)[:BEGIN]) for field, x in shown.items())
    after = any(not np.array_equal(x[BEGIN:], getattr(healthy, field)[BEGIN:]) for field, x in shown.items())
    assert before
    assert after or drive.housing.sensor_error_K == FAULTS["temperature_off"].usual


@pytest.mark.slow
@pytest.mark.parametrize("name", [row.name for row in FAULTS.values() if row.end])
def test_a_fault_that_ends_leaves_the_truth_behind(healthy: Samples, name: str) -> None:
    faulty, drive = run(f"{name}@0.2-0.3")
    near = slice(END + 150, None)  # what was added to the gear rings out: 8.5 per cent of critical at 225 Hz
    assert abs(faulty.counts_out[near] - healthy.counts_out[near]).max() <= 5
    assert abs(faulty.counts_in[near] - healthy.counts_in[near]).max() <= 5
    assert faulty.kept_in[near].all()
    assert faulty.kept_out[near].all()
    assert drive.housing.sensor_error_K == 0.0


@pytest.mark.parametrize("name", ["latch_shift", "latch_shift_in"])
def test_a_shifted_latch_tells_what_was_true_before(healthy: Samples, name: str) -> None:
    told, _ = counts(run(f"{name}@0.2:2ms")[0], name)
    true, _ = counts(healthy, name)
    assert abs(told[BEGIN:] - true[BEGIN - 2 : -2]).max() <= 3


@pytest.mark.parametrize("name", ["scaled", "scaled_in"])
def test_a_scaled_encoder_counts_too_much_of_the_motion_from_then_on(healthy: Samples, name: str) -> None:
    told, _ = counts(run(f"{name}@0.2:5%")[0], name)
    true, _ = counts(healthy, name)
    excess = told[BEGIN:] - true[BEGIN:]
    np.testing.assert_allclose(excess, 0.05 * (true[BEGIN:] - true[BEGIN - 1]), atol=4)


@pytest.mark.parametrize("name", ["sign_flipped", "sign_flipped_in"])
def test_a_flipped_encoder_counts_backward(healthy: Samples, name: str) -> None:
    told, _ = counts(run(f"{name}@0.2")[0], name)
    true, _ = counts(healthy, name)
    np.testing.assert_allclose(told[BEGIN:] + true[BEGIN:], 2 * true[BEGIN - 1], atol=5)


@pytest.mark.parametrize("name", ["offset", "offset_in"])
def test_a_slipped_coupling_moves_by_its_angle(healthy: Samples, name: str) -> None:
    told, step = counts(run(f"{name}@0.2:0.2rad")[0], name)
    true, _ = counts(healthy, name)
    np.testing.assert_allclose((told - true)[BEGIN:] * step, 0.2, atol=step)


def test_bits_are_stuck_and_lost(healthy: Samples) -> None:
    stuck, _ = counts(run("stuck_bit@0.2:9")[0], "stuck_bit")
    assert np.array_equal(stuck[BEGIN:], healthy.counts_out[BEGIN:] | 512)
    coarse, _ = counts(run("coarse_in@0.2:5")[0], "coarse_in")
    assert np.array_equal(coarse[BEGIN:], healthy.counts_in[BEGIN:] & ~31)


def test_frames_get_lost_in_their_share() -> None:
    lossy, _ = run("dropped_in@0.2:30%", until_s=2.2)
    assert lossy.kept_in[BEGIN:].mean() == pytest.approx(0.7, abs=0.04)
    assert lossy.kept_out.all()


def test_torque_comes_late_and_too_large(healthy: Samples) -> None:
    late, _ = run("torque_lag@0.2:5ms")
    true = healthy.motor_torque_Nm
    np.testing.assert_allclose(late.motor_torque_Nm[BEGIN:], true[BEGIN - 5 : -5], atol=1e-6)
    scaled, _ = run("torque_scaled@0.2:20%")
    np.testing.assert_allclose(scaled.motor_current_A[BEGIN:], 1.2 * healthy.motor_current_A[BEGIN:])


def test_real_wear_softens_the_gear_itself_and_a_gap_gives_way() -> None:
    _, worn = run("wear@0.2:3%")
    assert worn.plant.stiffness_scale == pytest.approx(0.97)
    sound, gaping = run("wear@9:3%"), run("backlash@0.2:100urad")
    size = [
        np.abs(one.counts_in * IN_RAD / 100 - one.counts_out * OUT_RAD)[BEGIN:].max() for one in (sound[0], gaping[0])
    ]
    assert size[1] > size[0] + 2e-5


@pytest.mark.parametrize(
    ("text", "name", "begin_s", "end_s", "size"),
    [
        ("latch_shift@60:0.3ms", "latch_shift", 60.0, np.inf, 3e-4),
        ("latch_shift:0.3ms", "latch_shift", 60.0, np.inf, 3e-4),
        ("dropped_in@5-8:50%", "dropped_in", 5.0, 8.0, 0.5),
        ("scaled@2:-1 %", "scaled", 2.0, np.inf, -0.01),
        ("wear:0.03", "wear", 60.0, np.inf, 0.03),
        ("offset@1:3deg", "offset", 1.0, np.inf, np.deg2rad(3)),
        ("backlash@1:1e-4", "backlash", 1.0, np.inf, 1e-4),
    ],
)
def test_what_a_person_types(text: str, name: str, begin_s: float, end_s: float, size: float) -> None:
    plan = planned(text)
    assert (plan.fault.name, plan.begin_s, plan.end_s) == (name, begin_s, end_s)
    assert plan.size == pytest.approx(size)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("latch_shif@60", "did you mean 'latch_shift'"),
        ("melted", "expected one of frozen"),
        ("latch_shift@soon", "'soon': expected seconds"),
        ("latch_shift@-3", "expected"),
        ("latch_shift@60-50", "after it begins"),
        ("reset@60-90", "does not end"),
        ("latch_shift:3kg", "expected a number with one of: s, ms, us"),
        ("latch_shift:1s", "expected 0 to 0.05"),
        ("dropped:150%", "expected 0 to 1"),
        ("frozen:3", "no size"),
        ("wear:nan", "expected a number"),
        ("", "expected NAME"),
        ("wear:", "expected a number"),
        ("stuck_bit:2.5", "whole"),
    ],
)
def test_bad_names_and_sizes_give_one_clear_line(text: str, words: str) -> None:
    with pytest.raises(BadInput, match=words) as told:
        planned(text)
    assert "\n" not in str(told.value)

"""Readings into blocks, judged against the motion that the readings were made from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from scipy.interpolate import KroghInterpolator

from edge_daemon.condition.conditioner import HOLD_S, Conditioner
from edge_daemon.config.settings import ChannelSettings, Drive
from edge_daemon.records import Array, Block, Event, Flaw, Readings

RATE_HZ = 1000.0
EPOCH_S = 1_763_700_000.0
IN_COUNTS, OUT_COUNTS = 2**17, 2**20
RATIO = 100.0

THETA_IN = ChannelSettings(channel="theta_in_rad", source="can", signal="in", counts_per_turn=IN_COUNTS)
THETA_OUT = ChannelSettings(channel="theta_out_rad", source="can", signal="out", counts_per_turn=OUT_COUNTS)
TEMPERATURE = ChannelSettings(channel="temperature_degC", source="i2c", signal="t", unit="K", stale_after_s=2.0)


def drive(*channels: ChannelSettings, rate_hz: float = RATE_HZ) -> Drive:
    return Drive(name="axis", modbus_device_id=1, model="axis.toml", channels=channels, rate_hz=rate_hz)


def out_angle(time_s: Array) -> Array:
    """The output's motion: a sine of 0.1 rad at 2 Hz, rest at the start."""
    angle: Array = 0.1 - 0.1 * np.cos(4 * math.pi * (time_s - EPOCH_S))
    return angle


def counts(angle_rad: Array, per_turn: float) -> Array:
    return np.rint(angle_rad * per_turn / (2 * math.pi))


def stamps(seconds: float, rate_hz: float = RATE_HZ, start_s: float = EPOCH_S) -> Array:
    return start_s + np.arange(round(seconds * rate_hz)) / rate_hz


def encoders(time_s: Array) -> list[Readings]:
    """Both encoders latched together."""
    return [
        Readings("can", "in", time_s, counts(RATIO * out_angle(time_s), IN_COUNTS)),
        Readings("can", "out", time_s, counts(out_angle(time_s), OUT_COUNTS)),
    ]


def fed(conditioner: Conditioner, readings: Iterable[Readings], batch: int = 20) -> list[Block]:
    """All readings in batches in order of time, the clock at the newest one; then everything begun is closed."""
    cut = [
        (float(row.time_s[i : i + batch].max()), Readings(row.source, row.signal, row.time_s[i : i + batch], part))
        for row in readings
        for i in range(0, len(row.time_s), batch)
        for part in [row.value[i : i + batch]]
    ]
    blocks: list[Block] = []
    for now_s, row in sorted(cut, key=lambda pair: pair[0]):
        conditioner.push(row)
        blocks += conditioner.blocks(now_s)
    return blocks + conditioner.blocks(math.inf)


def joined(blocks: list[Block], channel: str) -> tuple[Array, Array, np.typing.NDArray[np.uint8]]:
    """Time, values and flaws of a channel over all blocks."""
    return (
        np.concatenate([block.time_s for block in blocks]),
        np.concatenate([block.values[channel] for block in blocks]),
        np.concatenate([block.flaws[channel] for block in blocks]),
    )


def flawed(blocks: list[Block], channel: str, flaw: Flaw) -> np.typing.NDArray[np.bool_]:
    found: np.typing.NDArray[np.bool_] = joined(blocks, channel)[2] & int(flaw) != 0
    return found


# latched together


def test_latched_samples_come_back_to_the_last_bit_on_the_devices_own_instants() -> None:
    time_s = stamps(1.0, start_s=EPOCH_S + 0.000_377)
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), encoders(time_s))
    assert [block.sequence for block in blocks] == list(range(1, 11))
    for channel, angle, per_turn in (
        ("theta_in_rad", RATIO * out_angle(time_s), IN_COUNTS),
        ("theta_out_rad", out_angle(time_s), OUT_COUNTS),
    ):
        at_s, values, flaws = joined(blocks, channel)
        assert np.array_equal(values, counts(angle, per_turn) * (2 * math.pi / per_turn))
        assert not flaws.any()
        assert np.abs(at_s - time_s).max() < 1e-6


def test_the_grid_follows_a_device_whose_crystal_is_off_and_no_sample_is_lost_or_taken_twice() -> None:
    time_s = EPOCH_S + np.arange(20_000) / RATE_HZ * (1 + 80e-6)
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), encoders(time_s))
    at_s, values, flaws = joined(blocks, "theta_out_rad")
    assert not flaws.any()
    assert np.array_equal(values, counts(out_angle(time_s), OUT_COUNTS) * (2 * math.pi / OUT_COUNTS))
    assert np.abs(at_s - time_s).max() < 10e-6


def test_jitter_of_common_stamps_does_not_touch_latched_values() -> None:
    time_s = stamps(2.0)
    jittered_s = time_s + np.random.default_rng(4).uniform(0.0, 2e-4, len(time_s))
    rows = [Readings(row.source, row.signal, jittered_s, row.value) for row in encoders(time_s)]
    _, values, flaws = joined(fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows), "theta_in_rad")
    assert not flaws.any()
    assert np.array_equal(values, rows[0].value * (2 * math.pi / IN_COUNTS))


def test_a_lost_frame_is_one_missing_sample_of_one_channel() -> None:
    time_s = stamps(0.5)
    rows = encoders(time_s)
    kept = np.arange(len(time_s)) != 123
    rows[0] = Readings("can", "in", time_s[kept], rows[0].value[kept])
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows)
    _, values, flaws = joined(blocks, "theta_in_rad")
    assert np.flatnonzero(flaws).tolist() == [123]
    assert flaws[123] == Flaw.MISSING
    assert np.isnan(values[123])
    assert np.isfinite(np.delete(values, 123)).all()
    assert not joined(blocks, "theta_out_rad")[2].any()


# free running


def test_a_free_running_encoder_is_moved_onto_the_others_grid_within_its_resolution() -> None:
    time_s = stamps(2.0)
    late_s = time_s + 0.000_4
    rows = [Readings("can", "in", late_s, counts(RATIO * out_angle(late_s), IN_COUNTS)), encoders(time_s)[1]]
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows)
    at_s, values, flaws = joined(blocks, "theta_in_rad")
    good = flaws == 0
    assert good.sum() >= len(time_s) - 2
    assert np.abs(values - RATIO * out_angle(at_s))[good].max() < 2 * math.pi / IN_COUNTS
    assert np.array_equal(joined(blocks, "theta_out_rad")[1], rows[1].value * (2 * math.pi / OUT_COUNTS))


def test_a_channels_latency_is_taken_off_before_it_is_aligned() -> None:
    time_s = stamps(1.0)
    latency_s = 0.001_3
    row = ChannelSettings(**{**_fields(THETA_IN), "latency_s": latency_s})
    taken_s = time_s - latency_s
    rows = [Readings("can", "in", time_s, counts(RATIO * out_angle(taken_s), IN_COUNTS)), encoders(time_s)[1]]
    at_s, values, flaws = joined(fed(Conditioner(drive(row, THETA_OUT)), rows), "theta_in_rad")
    good = flaws == 0
    assert good.sum() > 990
    assert np.abs(values - RATIO * out_angle(at_s))[good].max() < 2 * math.pi / IN_COUNTS


def test_no_value_is_interpolated_across_a_gap() -> None:
    time_s = stamps(1.0)
    late_s = time_s + 0.000_5
    kept = (np.arange(len(time_s)) < 400) | (np.arange(len(time_s)) >= 430)
    rows = [
        Readings("can", "in", late_s[kept], counts(RATIO * out_angle(late_s[kept]), IN_COUNTS)),
        encoders(time_s)[1],
    ]
    at_s, values, flaws = joined(fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows), "theta_in_rad")
    inside = (at_s > late_s[399]) & (at_s < late_s[430])
    assert inside.sum() == 31
    assert (flaws[inside] == Flaw.MISSING).all()
    assert np.isnan(values[inside]).all()
    good = flaws == 0
    assert good.sum() >= 968
    assert np.abs(values - RATIO * out_angle(at_s))[good].max() < 2 * math.pi / IN_COUNTS


def test_between_readings_stands_the_cubic_through_the_four_nearest() -> None:
    """Against Newton's interpolation of scipy, to the last digits that times since 1970 allow."""
    time_s = stamps(1.0)
    uneven_s = time_s + 0.000_4 + np.random.default_rng(6).uniform(0.0, 3e-4, len(time_s))
    raw = np.cumsum(np.random.default_rng(7).normal(size=len(time_s)))
    torque = ChannelSettings(channel="torque_in_Nm", source="can", signal="q")
    blocks = fed(Conditioner(drive(THETA_OUT, torque)), [encoders(time_s)[1], Readings("can", "q", uneven_s, raw)])
    at_s, values, flaws = joined(blocks, "torque_in_Nm")
    for i in np.flatnonzero(flaws == 0)[2:-2:37]:
        left = int(np.searchsorted(uneven_s, at_s[i], side="right")) - 1
        near = slice(left - 1, left + 3)
        expected = KroghInterpolator(1e3 * (uneven_s[near] - at_s[i]), raw[near])(0.0)
        assert values[i] == pytest.approx(float(expected), abs=1e-9)
    assert (flaws == 0).sum() >= 996


def test_an_uneven_recording_below_the_nominal_rate_is_interpolated_on_an_even_grid() -> None:
    rng = np.random.default_rng(94)
    time_s = EPOCH_S + np.arange(940) / 94.0 + rng.uniform(-1e-3, 1e-3, 940)
    smooth = [Readings("file", "q", time_s, np.sin(2 * (time_s - EPOCH_S)))]
    row = ChannelSettings(channel="theta_out_rad", source="file", signal="q")
    blocks = fed(Conditioner(drive(row, rate_hz=100.0)), smooth)
    at_s, values, flaws = joined(blocks, "theta_out_rad")
    assert np.ptp(np.diff(at_s)) < 1e-6
    good = flaws == 0
    assert good.sum() > 980
    # cubic through points 10.6 ms apart: error below 3/128 h^4 max|x''''| = 3/128 * 0.0127^4 * 16
    assert np.abs(values - np.sin(2 * (at_s - EPOCH_S)))[good].max() < 3 / 128 * 0.0127**4 * 16


def fast_angle(time_s: Array) -> Array:
    """The output's motion: a beat of 9 Hz and 2 Hz, up to 3 rad/s."""
    since_s = time_s - EPOCH_S
    angle: Array = 0.05 * np.sin(2 * math.pi * 9 * since_s) + 0.03 * np.sin(2 * math.pi * 2 * since_s)
    return angle


def lost_at_random(share: float) -> Array:
    return np.random.default_rng(round(100 * share)).uniform(size=8000) > share


def lost_in_bursts(most: int, silent: int) -> Array:
    """Runs of 1 to `most` readings, then up to `silent` lost ones."""
    rng = np.random.default_rng(silent)
    runs = [
        np.arange(n) < m for n, m in zip(rng.integers(most, silent, 4000), rng.integers(1, most, 4000), strict=True)
    ]
    return np.concatenate(runs)[:8000]


def back_after(kept: Array) -> Array:
    """All of them from the third second on."""
    return np.where(np.arange(8000) < 3000, kept, True)


LOSSES = {
    **{f"{100 * share:.0f} % lost": lost_at_random(share) for share in (0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)},
    "bursts of 20": lost_in_bursts(3, 20),
    "bursts of 60": lost_in_bursts(8, 60),
    **{f"every {n}th": np.arange(8000) % n == 0 for n in (2, 5, 10, 25)},
    "back after 90 %": back_after(lost_at_random(0.9)),
    "back after every 10th": back_after(np.arange(8000) % 10 == 0),
}


@pytest.mark.parametrize("turning", [1, -1])
@pytest.mark.parametrize("kept", LOSSES.values(), ids=LOSSES.keys())
def test_nothing_good_is_off_by_more_than_the_encoders_step_however_many_readings_are_lost(
    kept: Array, turning: int
) -> None:
    """From the first one on; each reading tells truly when it was taken, a few tenths of a period off the grid."""
    time_s = stamps(8.0)
    taken_s = (time_s + np.random.default_rng(5).uniform(0.000_2, 0.000_6, len(time_s)))[kept]
    rows = [
        Readings("can", "in", taken_s, counts(turning * RATIO * fast_angle(taken_s), IN_COUNTS)),
        Readings("can", "out", time_s, counts(turning * fast_angle(time_s), OUT_COUNTS)),
    ]
    at_s, values, flaws = joined(fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows), "theta_in_rad")
    good = flaws == 0
    wrong_steps = np.abs(values - turning * RATIO * fast_angle(at_s))[good] * IN_COUNTS / (2 * math.pi)
    assert wrong_steps.max(initial=0.0) < 1.5
    if kept[3000:].all():
        assert good[(at_s > EPOCH_S + 3.1) & (at_s < EPOCH_S + 7.99)].all(), "what comes at the full rate again is used"


@pytest.mark.parametrize(("lost", "least"), [(0.0, 0.9), (0.2, 0.3)])
def test_a_slow_encoder_is_used_where_its_readings_tell_the_motion(lost: float, least: float) -> None:
    time_s = stamps(8.0)
    slow_s = stamps(8.0, rate_hz=230.0) + 0.000_3
    slow_s = slow_s[np.random.default_rng(2).uniform(size=len(slow_s)) >= lost]
    rows = [Readings("can", "in", slow_s, counts(RATIO * out_angle(slow_s), IN_COUNTS)), encoders(time_s)[1]]
    at_s, values, flaws = joined(fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows), "theta_in_rad")
    good = (flaws == 0) & (at_s > EPOCH_S + 0.5)
    assert good.mean() > least
    assert np.abs(values - RATIO * out_angle(at_s))[good].max() < 1.5 * 2 * math.pi / IN_COUNTS


# slow channels


def test_a_slow_channel_is_held_until_it_is_stale() -> None:
    time_s = stamps(6.0)
    slow = Readings("i2c", "t", EPOCH_S + np.array([0.95, 1.95]), np.array([300.0, 301.0]))
    blocks = fed(Conditioner(drive(THETA_OUT, TEMPERATURE)), [encoders(time_s)[1], slow], batch=1)
    at_s, values, flaws = joined(blocks, "temperature_degC")
    at_s = at_s - EPOCH_S
    assert (flaws[at_s < 0.9499] == Flaw.MISSING).all()
    for first_s, last_s, value, flaw in (
        (1.01, 1.949, 26.85, 0),
        (2.01, 3.94, 27.85, 0),
        (3.96, 5.9, 27.85, Flaw.STALE),
    ):
        part = (at_s >= first_s) & (at_s < last_s)
        assert np.allclose(values[part], value, rtol=0, atol=1e-9)
        assert (flaws[part] == flaw).all()


TORQUE = ChannelSettings(channel="torque_out_Nm", source="can", signal="torque")


def told_torque(rate_hz: float, kept: Callable[[Array], Array], late_s: float = 0.0) -> tuple[list[Block], list[Event]]:
    """Blocks and events of 8 s beside an encoder; a torque that grows by 1 N m in a second, read at `rate_hz`, of which
    the readings at `kept` times [s] are there, `late_s` after their stamps."""
    time_s, at_s = stamps(8.0), stamps(8.0, rate_hz)
    at_s = at_s[kept(at_s - EPOCH_S)]
    conditioner, encoder = Conditioner(drive(THETA_OUT, TORQUE)), encoders(time_s)[1]
    blocks: list[Block] = []
    for end_s in np.arange(0.02, 8.2, 0.02) + EPOCH_S:
        for row, values, delay_s in (("out", encoder, 0.0), ("torque", None, late_s)):
            own_s = time_s if values is not None else at_s
            now = (own_s + delay_s <= end_s) & (own_s + delay_s > end_s - 0.02)
            told = values.value[now] if values is not None else own_s[now] - EPOCH_S
            conditioner.push(Readings("can", row, own_s[now], told))
        blocks += conditioner.blocks(float(end_s))
    return blocks + conditioner.blocks(math.inf), conditioner.take_events()


def lost_after_two(share: float) -> Callable[[Array], Array]:
    """Readings of which this share is lost, by chance, from 2 s on."""
    rng = np.random.default_rng(8)
    return lambda at_s: (at_s < 2.0) | (rng.random(len(at_s)) > share)


@pytest.mark.parametrize("share", [0.7, 0.95])
@pytest.mark.parametrize("rate_hz", [RATE_HZ, 100.0])
def test_a_channel_that_loses_most_of_its_readings_is_not_held_as_if_it_had_none_lost(
    rate_hz: float, share: float
) -> None:
    blocks, events = told_torque(rate_hz, lost_after_two(share))
    at_s, values, flaws = joined(blocks, "torque_out_Nm")
    good = (flaws == 0) & (at_s < EPOCH_S + 7.8)
    assert good[at_s < EPOCH_S + 1.9].mean() > 0.98
    behind = at_s[good] - EPOCH_S - values[good]
    oldest = 3.0 if rate_hz < RATE_HZ else 0.0  # held or interpolated
    blocks_end_s = 0.12 if rate_hz < RATE_HZ and share > 0.9 else 0.0
    assert np.quantile(np.abs(behind), 0.9) < oldest / rate_hz + 1e-6 + blocks_end_s
    assert good[at_s > EPOCH_S + 3.0].mean() < 0.6
    assert [event.message for event in events if event.source == "torque_out_Nm"][:1] == ["readings are missing"]


def test_a_channel_that_is_read_at_a_lower_rate_for_good_is_held_again() -> None:
    blocks, _ = told_torque(100.0, lambda at_s: (at_s < 2.0) | (np.arange(len(at_s)) % 4 == 0))
    at_s, _, flaws = joined(blocks, "torque_out_Nm")
    assert (flaws[(at_s > EPOCH_S + 6.0) & (at_s < EPOCH_S + 7.8)] == 0).all()


@pytest.mark.parametrize("late_s", [0.0, 0.07])
def test_a_channel_that_is_only_late_has_lost_nothing(late_s: float) -> None:
    blocks, events = told_torque(100.0, lambda at_s: at_s >= 0.0, late_s)
    at_s, _, flaws = joined(blocks, "torque_out_Nm")
    assert (flaws[(at_s > EPOCH_S + 0.5) & (at_s < EPOCH_S + 7.8)] == 0).all()
    assert not events


def test_an_unknown_signal_is_ignored_and_counted() -> None:
    conditioner = Conditioner(drive(THETA_OUT))
    conditioner.push(Readings("can", "other", np.array([1.0]), np.array([1.0])))
    assert conditioner.blocks(math.inf) == []
    assert conditioner.counters()["ignored"] == 1


# when blocks are closed


def test_a_dead_encoder_stops_nobody_for_longer_than_the_hold() -> None:
    time_s = stamps(3.0)
    rows = encoders(time_s)
    rows[0] = Readings("can", "in", time_s[:1000], rows[0].value[:1000])
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    age_s = []
    for i in range(0, 3000, 20):
        for row in rows:
            conditioner.push(Readings(row.source, row.signal, row.time_s[i : i + 20], row.value[i : i + 20]))
        now_s = float(time_s[i + 19])
        age_s += [now_s - block.end_s for block in conditioner.blocks(now_s)]
    assert max(age_s) <= HOLD_S + 0.06
    assert max(age_s[-10:]) < 0.06, "once known to be dead it is not waited for"
    assert "silent" in [event.message for event in conditioner.take_events()]


def test_silence_gives_no_blocks_but_is_told_and_the_return_is_a_gap() -> None:
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    blocks = []
    for row in encoders(stamps(0.45)):
        conditioner.push(row)
    for now_s in EPOCH_S + 0.45 + np.arange(0, 60, 0.1):
        blocks += conditioner.blocks(float(now_s))
    assert len(blocks) == 5, "four full ones and the begun one"
    assert flawed(blocks, "theta_in_rad", Flaw.MISSING).sum() == 50
    assert conditioner.age_s("theta_in_rad", EPOCH_S + 60.0) == pytest.approx(60.0 - 0.449, abs=1e-3)
    (event,) = conditioner.take_events()
    assert (event.source, event.message) == ("theta_in_rad, theta_out_rad", "silent"), "one cable, one line"
    back_s = stamps(0.5, start_s=EPOCH_S + 60.0)
    for row in encoders(back_s):
        conditioner.push(row)
    again = conditioner.blocks(math.inf)
    assert [block.sequence for block in again] == list(range(6, 11))
    assert again[0].start_s == pytest.approx(EPOCH_S + 60.0, abs=1e-6)
    assert conditioner.counters()["gaps"] == 1


def test_a_process_that_stood_still_takes_what_came_meanwhile_and_calls_nobody_silent() -> None:
    """It may look before the readings that waited for it in the kernel are taken."""
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    rows = encoders(stamps(3.0))
    blocks = []
    for i, j, looks_s in ((0, 450, (0.45, 2.9)), (450, 3000, (2.905,))):
        for row in rows:
            conditioner.push(Readings(row.source, row.signal, row.time_s[i:j], row.value[i:j]))
        for look_s in looks_s:
            blocks += conditioner.blocks(EPOCH_S + look_s)
    blocks += conditioner.blocks(math.inf)
    assert len(blocks) == 30
    assert not flawed(blocks, "theta_in_rad", Flaw.MISSING).any()
    assert conditioner.take_events() == []


def test_late_readings_within_the_horizon_are_used_and_later_ones_counted() -> None:
    rng = np.random.default_rng(8)
    time_s = stamps(1.0)
    order = np.argsort(np.arange(1000) + rng.uniform(0, 15, 1000))
    rows = [Readings(row.source, row.signal, time_s[order], row.value[order]) for row in encoders(time_s)]
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    blocks = fed(conditioner, rows, batch=10)
    assert not flawed(blocks, "theta_in_rad", Flaw.MISSING).any()
    assert conditioner.counters()["late"] == 0
    conditioner.push(Readings("can", "in", time_s[500:510], rows[0].value[500:510]))
    for now_s in EPOCH_S + np.arange(2.0, 3.0, 0.1):
        assert conditioner.blocks(float(now_s)) == []
    assert conditioner.counters()["late"] == 10


def test_duplicates_and_a_stamp_from_the_far_future_do_no_harm() -> None:
    time_s = stamps(1.0)
    rows = encoders(time_s)
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    blocks = []
    for i in range(0, 1000, 20):
        for row in rows:
            part = Readings(row.source, row.signal, row.time_s[i : i + 20], row.value[i : i + 20])
            conditioner.push(part)
            conditioner.push(part)
        if i == 500:
            conditioner.push(Readings("can", "in", np.array([EPOCH_S + 1e6]), np.array([0.0])))
        blocks += conditioner.blocks(float(time_s[i + 19]))
    blocks += conditioner.blocks(math.inf)
    assert len(blocks) == 10
    _, values, flaws = joined(blocks, "theta_in_rad")
    assert not flaws.any()
    assert np.array_equal(values, rows[0].value * (2 * math.pi / IN_COUNTS))
    assert conditioner.counters()["duplicate"] >= 1000
    assert conditioner.counters()["misstamped"] == 1


def test_memory_is_bounded_while_nobody_asks_for_blocks() -> None:
    conditioner = Conditioner(drive(THETA_OUT))
    for i in range(60):
        time_s = stamps(1.0, start_s=EPOCH_S + i)
        conditioner.push(Readings("can", "out", time_s, np.zeros(1000)))
    assert conditioner.counters()["overrun"] >= 50_000
    assert len(conditioner.blocks(math.inf)) <= 101


def test_a_jump_of_the_clock_ahead_is_a_gap_and_time_never_runs_back() -> None:
    rows = [*encoders(stamps(0.5)), *encoders(stamps(0.5, start_s=EPOCH_S + 86_400.0))]
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows)
    starts_s = [block.start_s for block in blocks]
    assert starts_s == sorted(starts_s)
    assert len(blocks) == 10
    assert starts_s[5] == pytest.approx(EPOCH_S + 86_400.0, abs=1e-6)


# flaws


def test_flaws_are_told_once_when_they_set_in_and_once_when_they_are_gone() -> None:
    row = ChannelSettings(channel="torque_in_Nm", source="can", signal="q", unit="mN m", maximum=2.0)
    time_s = stamps(10.0)
    value = np.where((time_s > EPOCH_S + 2) & (time_s < EPOCH_S + 4), 3000.0, 1000.0)
    conditioner = Conditioner(drive(row))
    blocks = fed(conditioner, [Readings("can", "q", time_s, value)])
    assert np.array_equal(flawed(blocks, "torque_in_Nm", Flaw.RANGE), value > 2000)
    events: list[Event] = conditioner.take_events()
    assert [event.message for event in events] == ["outside its range", "no longer: outside its range"]
    assert events[0].time_s == pytest.approx(EPOCH_S + 2.0, abs=0.11)
    assert conditioner.take_events() == []
    assert conditioner.counters()["torque_in_Nm.range"] == (value > 2000).sum()


@pytest.mark.parametrize(("lossy_s", "told"), [(0.3, 0), (3.0, 2)])
def test_a_hiccup_is_counted_and_lasting_loss_is_told(lossy_s: float, told: int) -> None:
    time_s = stamps(8.0)
    rows = encoders(time_s)
    rng = np.random.default_rng(3)
    lossy = (time_s > EPOCH_S + 2.0) & (time_s < EPOCH_S + 2.0 + lossy_s)
    kept = ~lossy | (rng.random(len(time_s)) > 0.4)
    rows = [Readings(row.source, row.signal, time_s[kept], row.value[kept]) for row in rows]
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    fed(conditioner, rows)
    assert conditioner.counters()["theta_in_rad.missing"] == (~kept).sum()
    events = conditioner.take_events()
    assert [event.message for event in events] == ["readings are missing", "no longer: readings are missing"][:told]
    assert all(event.source == "theta_in_rad, theta_out_rad" for event in events)
    assert not told or events[0].time_s == pytest.approx(EPOCH_S + 2.0, abs=0.11)


def test_a_device_error_is_a_flaw_and_the_angle_goes_on_after_it() -> None:
    time_s = stamps(0.5)
    rows = encoders(time_s)
    value = rows[0].value.copy()
    value[200:220] = math.nan
    rows[0] = Readings("can", "in", time_s, value)
    blocks = fed(Conditioner(drive(THETA_IN, THETA_OUT)), rows)
    assert np.flatnonzero(flawed(blocks, "theta_in_rad", Flaw.DEVICE)).tolist() == list(range(200, 220))
    assert joined(blocks, "theta_in_rad")[1][-1] == rows[0].value[-1] * (2 * math.pi / IN_COUNTS)


def test_a_jump_that_stays_is_told_once_and_kept() -> None:
    """One tooth of 200: the gear itself can do that, so it is told and never corrected."""
    time_s = stamps(3.0)
    tooth = 2 * math.pi / 200
    theta_in, theta_out = encoders(time_s)
    slipped = theta_out.value + np.where(np.arange(len(time_s)) >= 1200, counts(tooth, OUT_COUNTS), 0.0)
    slow = ChannelSettings(
        channel="theta_out_rad", source="can", signal="out", counts_per_turn=OUT_COUNTS, max_rate=4.0
    )
    conditioner = Conditioner(drive(THETA_IN, slow))
    blocks = fed(conditioner, [theta_in, Readings("can", "out", time_s, slipped)])
    (event,) = conditioner.take_events()
    assert event.source == "theta_out_rad" and event.message.startswith("jumped by 0.031")
    assert conditioner.counters()["theta_out_rad.jumps"] == 1
    placed_s, out, _ = joined(blocks, "theta_out_rad")
    assert out[-1] - out_angle(placed_s[-1:])[0] == pytest.approx(tooth, abs=2 * math.pi / OUT_COUNTS)


def test_a_reset_is_told_counted_and_the_twist_goes_on() -> None:
    time_s = stamps(2.0)
    true = counts(RATIO * out_angle(time_s), IN_COUNTS)
    value = true.copy()
    value[700:] -= true[700] - 17.0
    rows = [Readings("can", "in", time_s, value), encoders(time_s)[1]]
    conditioner = Conditioner(drive(THETA_IN, THETA_OUT))
    blocks = fed(conditioner, rows)
    flaws = flawed(blocks, "theta_in_rad", Flaw.RESET)
    assert np.flatnonzero(flaws).tolist() == [698, 699, 700, 701, 702]
    error = joined(blocks, "theta_in_rad")[1] - true * (2 * math.pi / IN_COUNTS)
    assert np.abs(error[:700]).max() == 0
    assert np.ptp(error[700:]) < 1e-9
    # the step over the reset is bridged at the speed before it: at most acceleration * (half the samples that tell it)
    assert np.abs(error[700:]).max() < RATIO * 0.1 * 16 * math.pi**2 * 9e-3 * 1e-3 + 2 * math.pi / IN_COUNTS
    assert conditioner.counters()["theta_in_rad.resets"] == 1
    assert any("lost its reference" in event.message for event in conditioner.take_events())


def _fields(row: ChannelSettings) -> dict[str, object]:
    return {name: getattr(row, name) for name in row.__struct_fields__}

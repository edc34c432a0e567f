"""The map from a device's counter to the gateway's clock, on simulated clocks and delays."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.acquire.device_clock import SETTLE_S, DeviceClock
from edge_daemon.records import Array

SEED = 99
START_S = 1.7e9
MICRO = 1e-6
WRAP = 2.0**32
FLOAT_S = 5e-7
"""two roundings of a float of this date"""


def device(seconds: float, rate_hz: float, drift: float, start: float = 0.0) -> tuple[Array, Array]:
    """True instants, and the counter [us] of a device whose crystal runs `drift` fast."""
    true_s = np.arange(0, seconds, 1 / rate_hz)
    return START_S + true_s, np.floor(start + true_s * (1 + drift) / MICRO) % WRAP


def delays(n: int, rng: np.random.Generator) -> Array:
    """Seldom none, mostly a few milliseconds, now and then long."""
    late = rng.exponential(2e-3, n)
    late[rng.random(n) < 0.002] += 0.05
    return late


def in_order(arrival_s: Array) -> Array:
    """A bus hands frames out in order: a late one holds up the next."""
    return np.maximum.accumulate(arrival_s)


def check(mapped: Array, arrival_s: Array, expected_s: Array, atol: float = FLOAT_S) -> None:
    """Only what came in the first moments has no time; all else has the right one."""
    early = arrival_s < arrival_s[0] + SETTLE_S
    np.testing.assert_array_equal(np.isnan(mapped), early)
    np.testing.assert_allclose(mapped[~early], expected_s[~early], rtol=0, atol=atol)


def mapped_by(clock: DeviceClock, counts: Array, arrival_s: Array, size: int, message: str = "a") -> Array:
    """What the clock says of messages that come `size` at a time."""
    parts = range(0, len(counts), size)
    return np.concatenate([clock.times(message, counts[i : i + size], arrival_s[i : i + size]) for i in parts])


@pytest.mark.parametrize("drift", [0.0, 50e-6, -200e-6])
def test_delays_are_taken_out_and_drift_is_followed(drift: float) -> None:
    rng = np.random.default_rng(SEED)
    true_s, counts = device(60, 500, drift, start=WRAP - 10_000_000)  # rolls over after ten seconds
    arrival_s = in_order(true_s + delays(len(true_s), rng))
    clock = DeviceClock(MICRO, WRAP)
    error_s = mapped_by(clock, counts, arrival_s, 5) - true_s
    settled = error_s[len(error_s) // 3 :]
    assert np.abs(settled).max() < 3e-4  # delays have a mean of two milliseconds, and go to sixty
    assert np.all(np.diff(error_s[np.isfinite(error_s)]) > -1 / 500)
    rate_error = np.diff(settled[::500])
    assert np.abs(rate_error).max() < 1e-4  # a second is a second within 100 ppm, at any time
    assert clock.jumps == 0


def test_equal_counts_are_equal_times_whenever_they_arrive() -> None:
    rng = np.random.default_rng(SEED)
    true_s, counts = device(20, 200, 80e-6)
    arrival_a, arrival_b = (in_order(true_s + delays(len(true_s), rng)) for _ in range(2))
    clock = DeviceClock(MICRO, WRAP)
    a: list[Array] = []
    b: list[Array] = []
    done_a = done_b = 0
    while done_b < len(counts):  # b comes in other portions, up to 1.5 s behind
        n = int(rng.integers(1, 300))
        if done_a < len(counts):
            a.append(clock.times("a", counts[done_a : done_a + n], arrival_a[done_a : done_a + n]))
        done_a = min(done_a + n, len(counts))
        n = min(int(rng.integers(1, 300)), done_a - done_b)
        if n:
            b.append(clock.times("b", counts[done_b : done_b + n], arrival_b[done_b : done_b + n]))
        done_b += n
    both = np.isfinite(np.concatenate(a)) & np.isfinite(np.concatenate(b))
    np.testing.assert_array_equal(np.concatenate(a)[both], np.concatenate(b)[both])
    assert np.count_nonzero(~both) < 30


def test_the_result_does_not_depend_on_batching() -> None:
    rng = np.random.default_rng(SEED)
    true_s, counts = device(15, 200, 30e-6)
    arrival_s = in_order(true_s + delays(len(true_s), rng))
    by_1, by_7, by_100 = (mapped_by(DeviceClock(MICRO, WRAP), counts, arrival_s, size) for size in (1, 7, 100))
    np.testing.assert_array_equal(by_1, by_7)
    np.testing.assert_array_equal(by_1, by_100)


def test_a_restarted_device_is_anchored_anew_and_counted() -> None:
    true_s, counts = device(10, 100, 0.0, start=5_000_000)
    restart = len(counts) // 2
    counts[restart:] -= counts[restart]  # the counter begins at zero
    clock = DeviceClock(MICRO, WRAP)
    mapped = mapped_by(clock, counts, true_s + 1e-3, 20)
    check(mapped, true_s, true_s + 1e-3)
    assert clock.jumps == 1


def test_frames_from_before_a_restart_may_come_after_it() -> None:
    true_s, counts = device(2, 100, 0.0, start=5_000_000)
    after = np.arange(10) * 10_000.0
    clock = DeviceClock(MICRO, WRAP)
    clock.times("a", counts, true_s)
    clock.times("b", counts[:-5], true_s[:-5])
    new = clock.times("a", after, true_s[-1] + 0.5 + after * MICRO)
    old = clock.times("b", counts[-5:], np.full(5, true_s[-1] + 0.55))
    np.testing.assert_allclose(old, true_s[-5:], atol=FLOAT_S)
    np.testing.assert_allclose(new, true_s[-1] + 0.5 + after * MICRO, atol=FLOAT_S)
    assert clock.jumps == 1


def test_a_single_corrupt_count_does_not_lose_the_map() -> None:
    true_s, counts = device(10, 100, 0.0)
    broken = counts.copy()
    broken[300] = 3e9
    clock = DeviceClock(MICRO, WRAP)
    mapped = mapped_by(clock, broken, true_s, 10)
    mapped[300] = true_s[300]
    check(mapped, true_s, true_s)


def test_a_stall_of_the_reader_leaves_the_times_in_place() -> None:
    true_s, counts = device(10, 100, 0.0)
    arrival_s = true_s.copy()
    arrival_s[300:500] = true_s[500]  # nobody read for two seconds, then all came at once
    clock = DeviceClock(MICRO, WRAP)
    mapped = mapped_by(clock, counts, arrival_s, 10)
    check(mapped, arrival_s, true_s)
    assert clock.jumps == 0


def test_a_long_silence_is_bridged_by_the_drift() -> None:
    true_s, counts = device(40, 50, 100e-6)
    late_s, late = true_s + 600.0, np.floor((true_s - START_S + 600.0) * (1 + 100e-6) / MICRO) % WRAP
    clock = DeviceClock(MICRO, WRAP)
    mapped_by(clock, counts, true_s, 10)
    mapped = clock.times("a", late[:10], late_s[:10])
    assert np.abs(mapped - late_s[:10]).max() < 5e-3  # 600 s at 100 ppm would be 60 ms off
    assert clock.jumps == 0


def test_a_stepped_gateway_clock_is_followed() -> None:
    true_s, counts = device(10, 100, 0.0)
    arrival_s = true_s + np.where(np.arange(1000) >= 500, 3600.0, 0.0)
    clock = DeviceClock(MICRO, WRAP)
    mapped = mapped_by(clock, counts, arrival_s, 10)
    check(mapped, arrival_s, arrival_s)
    assert clock.jumps == 1


def test_a_short_counter_rolls_over_many_times() -> None:
    rng = np.random.default_rng(SEED)
    true_s, counts = device(10, 1000, 0.0)
    counts %= 65_536  # 65 ms
    arrival_s = in_order(true_s + rng.uniform(0, 5e-3, len(true_s)))
    clock = DeviceClock(MICRO, 65_536.0)
    mapped = mapped_by(clock, counts, arrival_s, 10)
    np.testing.assert_allclose(np.diff(mapped[100:]), 1e-3, atol=1e-5)


def test_a_reader_that_begins_with_a_late_frame_is_not_misled() -> None:
    true_s, counts = device(3, 1000, 0.0)
    arrival_s = START_S + np.ceil((true_s - START_S) / 0.014) * 0.014  # an adapter that hands over every 14 ms
    arrival_s[0] = arrival_s[1]
    clock = DeviceClock(MICRO, WRAP)
    mapped = mapped_by(clock, counts, arrival_s, 14)
    check(mapped, arrival_s, true_s, atol=2e-3)  # the first frame of all came 13 ms late
    np.testing.assert_allclose(np.diff(mapped[100:]), 1e-3, rtol=1e-3)


def test_another_message_does_not_wait_for_one_that_fell_silent() -> None:
    true_s, counts = device(1, 100, 0.0)
    clock = DeviceClock(MICRO, WRAP)
    assert np.isnan(clock.times("gone", counts[:1], true_s[:1])).all()
    mapped = mapped_by(clock, counts, true_s, 1, "b")
    np.testing.assert_allclose(mapped[12:], true_s[12:], atol=FLOAT_S)


@pytest.mark.parametrize("seed", range(4))
def test_encoders_that_latch_together_keep_one_time_where_the_map_jumps(seed: int) -> None:
    """A gateway that reads late for minutes, as one does that is starved, takes that for the clocks' distance; then it
    catches up, frames come earlier than that, and the map jumps amid a batch."""
    rng = np.random.default_rng(seed)
    clock = DeviceClock(MICRO, WRAP)
    times: dict[str, list[tuple[int, float]]] = {"in": [], "out": []}
    now_s, read = 0.0, 0
    while now_s < 100.0:
        now_s += rng.uniform(0.05, 0.5)
        late_s = rng.uniform(0.35, 0.5) if 1.0 < now_s < 95.0 else 0.0
        fresh = np.arange(read, max(read, int(1000 * (now_s - late_s))))
        read += len(fresh)
        for message, seen in times.items():
            kept = fresh[rng.random(len(fresh)) > 0.03]
            if len(kept):
                arrival_s = np.full(len(kept), START_S + now_s)
                seen += zip(kept.tolist(), clock.times(message, 1000.0 * kept, arrival_s).tolist(), strict=True)
    assert clock.jumps == 1
    other = dict(times["out"])
    both = np.array([(time_s, other[count]) for count, time_s in times["in"] if count in other])
    assert len(both) > 90_000
    np.testing.assert_array_equal(both[:, 0], both[:, 1])
    for seen in times.values():
        known_s = np.array([time_s for _, time_s in seen if not np.isnan(time_s)])
        assert (np.diff(known_s) > 0).all(), "a time that was given to one instant is given to no other"
        assert len(seen) - len(known_s) < 0.6 * 1000, "only what overlaps is not used"

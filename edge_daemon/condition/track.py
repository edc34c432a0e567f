"""The readings of one channel on their way into blocks: arrived, sorted, calibrated, used, forgotten."""

from __future__ import annotations

import math

import numpy as np

from edge_daemon.condition.alignment import ascending
from edge_daemon.condition.calibration import Calibration
from edge_daemon.condition.stamp_watch import StampWatch
from edge_daemon.config.settings import ChannelSettings
from edge_daemon.records import Array, Flags

PENDING_S = 10.0
"""Readings are kept for at most this long while nobody asks for blocks."""
HELD_CHANNELS = frozenset({"profile_phase"})
"""These channels step and are never interpolated."""
SLOW_CHANNELS = frozenset(
    {"temperature_degC", "temperature_ambient_degC", "pressure_Pa", "force_axial_N", "force_radial_N", "sound_rms"}
)
"""These channels are taken for slow until their rate is known."""
SLOW_PERIODS = 2.5
"""A channel whose readings lie this many sample periods apart is held, not interpolated: below half the rate, with room
for jitter."""
FUTURE_S = 10.0
"""A reading that leaps ahead by this is believed once a second one confirms it (guess)."""
BACK_S = 1.0
"""A reading that later ones contradict by this was stamped wrongly (guess: no transport reorders over a second)."""
TAIL = 8
"""So many used samples are kept across the seam of two blocks: half of a cubic, and what its doubt looks at."""
EVIDENCE = 16
"""An encoder is taken for slow after so many distances: losses by chance look even so long once in 10^5 times."""
REMEMBERED = 64
"""The rate of a slow encoder is judged by so many distances, so that one block of losses does not change it."""
EVEN = 1.5
"""Distances within this factor of the middle one are one period of a slow encoder, with its jitter."""
LOST_PERIODS = 3.0
"""A held channel that has kept a period gives no value where it was silent for longer than so many of them, the number
after which a slow read counts as silent."""
CLOSE_SHARE, EVEN_SHARE = 0.1, 0.5
"""A slow encoder has at most the first share of distances shorter than a period, and at least the second of just one:
readings that follow one another closer tell that those between the others were lost (guess)."""


class Track:
    """Buffer of one channel. All times are of the sample: `latency_s` is already taken off."""

    def __init__(self, row: ChannelSettings, rate_hz: float) -> None:
        self.name = row.channel
        self.row = row
        self.calibration = Calibration(row, rate_hz)
        self._rate_hz = rate_hz
        self._most = max(int(PENDING_S * rate_hz), 64)
        self._arrived: list[tuple[Array, Array]] = []
        self._arrived_size = 0
        self._raw_s, self._raw = np.empty(0), np.empty(0)
        self.time_s, self.values = np.empty(0), np.empty(0)
        self.flaws: Flags = np.empty(0, dtype=np.uint8)
        self._frontier_s = -math.inf
        self._last_s = math.nan
        self.newest_s = -math.inf
        self.hint_s = -math.inf
        """the newest stamp seen, not yet checked: enough to know that a block is not due"""
        self.period_s = 1.0 / rate_hz
        self._distances_s = np.empty(0)
        self._kept_period_s = math.nan
        """that the channel was last seen to keep"""
        self._arrival_s = 0.0
        """how long after its stamp a reading was there at the latest, while none was lost"""
        self.held = row.channel in HELD_CHANNELS
        self.slow = self.held or row.channel in SLOW_CHANNELS
        self.awaited = not self.slow
        self.stamps = StampWatch()
        """of an angle"""
        self.counts = {"readings": 0, "late": 0, "duplicate": 0, "misstamped": 0, "overrun": 0}

    def push(self, time_s: Array, raw: Array) -> None:
        """Take what arrived; costs nothing but the reference."""
        if not len(time_s):
            return
        self._arrived.append((time_s, raw))
        self._arrived_size += len(time_s)
        hint_s = float(time_s[-1]) - self.row.latency_s
        if hint_s > self.hint_s:
            self.hint_s = hint_s
        self.counts["readings"] += len(time_s)
        while self._arrived_size > self._most and len(self._arrived) > 1:
            lost = len(self._arrived.pop(0)[0])
            self._arrived_size -= lost
            self.counts["overrun"] += lost

    def gather(self) -> None:
        """Sort what arrived into what waits."""
        if not self._arrived:
            return
        times, raws = zip((self._raw_s, self._raw), *self._arrived, strict=True)
        self._arrived, self._arrived_size = [], 0
        time_s, raw = np.concatenate(times), np.concatenate(raws).astype(np.float64, copy=False)
        if self.row.latency_s:
            time_s[len(self._raw_s) :] -= self.row.latency_s
        if self.calibration.angle:
            self.stamps.see(time_s[len(self._raw_s) :], 1.0 / self._rate_hz)
        time_s, raw = self._in_order(time_s, raw)
        if len(time_s) > self._most:
            self.counts["overrun"] += len(time_s) - self._most
            time_s, raw = time_s[-self._most :], raw[-self._most :]
        self._raw_s, self._raw = time_s, raw
        if len(time_s):
            self.awaited = not self.slow
            self.newest_s = max(self.newest_s, self._confirmed_s())
        self.hint_s = self.newest_s

    def _in_order(self, time_s: Array, raw: Array) -> tuple[Array, Array]:
        """Ascending, each instant once, nothing older than what has been used."""
        if not math.isfinite(time_s[-1]) or not ascending(time_s):
            time_s, raw = self._sorted(time_s, raw)
        if len(time_s) and time_s[0] < self._frontier_s:
            late = int(time_s.searchsorted(self._frontier_s, side="left"))
            self.counts["late"] += late
            time_s, raw = time_s[late:], raw[late:]
        return time_s, raw

    def _sorted(self, time_s: Array, raw: Array) -> tuple[Array, Array]:
        later_s = np.minimum.accumulate(np.where(np.isfinite(time_s), time_s, math.inf)[::-1])[::-1]
        right = np.isfinite(time_s) & (time_s <= later_s + BACK_S)
        self.counts["misstamped"] += len(time_s) - int(np.count_nonzero(right))
        time_s, raw = time_s[right], raw[right]
        order = np.argsort(time_s, kind="stable")
        time_s, raw = time_s[order], raw[order]
        first = np.ones(len(time_s), dtype=bool)
        np.not_equal(time_s[1:], time_s[:-1], out=first[1:])
        self.counts["duplicate"] += len(time_s) - int(np.count_nonzero(first))
        return time_s[first], raw[first]

    def _confirmed_s(self) -> float:
        """The newest waiting time that is not a lone leap into the future."""
        newest_s = float(self._raw_s[-1])
        before_s = float(self._raw_s[-2]) if len(self._raw_s) > 1 else self.newest_s
        if before_s > -math.inf and newest_s - before_s > FUTURE_S and not self.slow:
            return before_s
        return newest_s

    def first_s(self, from_s: float) -> float:
        """Time of the oldest sample not before `from_s`, calibrated or waiting; inf where there is none."""
        used = int(self.time_s.searchsorted(from_s, side="left"))
        if used < len(self.time_s):
            return float(self.time_s[used])
        waiting = int(self._raw_s.searchsorted(from_s, side="left"))
        if waiting == len(self._raw_s) or self._raw_s[waiting] > self.newest_s:
            return math.inf
        return float(self._raw_s[waiting])

    def last_before(self, time_s: float) -> float:
        """Time of the newest calibrated sample before `time_s`; before the first one, when the channel was first asked
        for."""
        used = int(self.time_s.searchsorted(time_s, side="left"))
        if used:
            self._last_s = float(self.time_s[used - 1])
        elif math.isnan(self._last_s):
            self._last_s = time_s
        return self._last_s

    def advance(self, until_s: float, moved_s: float) -> None:
        """Calibrate what waits before `until_s`; what arrives later for that time is too late."""
        if not self.slow:
            self._frontier_s = max(self._frontier_s, until_s)
        if not len(self._raw_s):
            return
        size = int(self._raw_s.searchsorted(min(until_s, math.nextafter(self.newest_s, math.inf)), side="left"))
        if not size:
            return
        time_s, raw = self._raw_s[:size], self._raw[:size]
        self._raw_s, self._raw = self._raw_s[size:], self._raw[size:]
        self._frontier_s = max(self._frontier_s, math.nextafter(time_s[-1], math.inf))
        values, flaws = self.calibration.apply(time_s, raw, (self._raw_s, self._raw), moved_s)
        self._measure_rate(time_s)
        if self.slow:
            self._measure_arrival(time_s, until_s)
        self.time_s = np.concatenate((self.time_s, time_s))
        self.values = np.concatenate((self.values, values))
        self.flaws = np.concatenate((self.flaws, flaws))

    def _measure_arrival(self, time_s: Array, now_s: float) -> None:
        """How late the newest reading is known, unless others were lost before it."""
        before_s = float(time_s[-2]) if len(time_s) > 1 else self.last_before(now_s)
        if float(time_s[-1]) - before_s <= self.lost_after_s:
            self._arrival_s = max(now_s - float(time_s[-1]), self._arrival_s * (1.0 - 1.0 / REMEMBERED))

    @property
    def step(self) -> float:
        """How far the interpolation may be in doubt [SI]: inf at the drive's rate, which tells the motion as well as
        was asked for, and where nothing says how finely the channel is read."""
        dense = self.period_s < EVEN / self._rate_hz
        return math.inf if dense else self.calibration.step

    @property
    def lost_after_s(self) -> float:
        """Between readings further apart than this others were lost; inf where the channel has kept no period yet, and
        of what changes so slowly that it may be held until it is stale."""
        lasting = self.held or self.name in SLOW_CHANNELS or math.isnan(self._kept_period_s)
        return math.inf if lasting else LOST_PERIODS * self._kept_period_s

    @property
    def missed_after_s(self) -> float:
        """The next reading is lost, not only late, so long after the newest."""
        return self.lost_after_s + self._arrival_s

    def _measure_rate(self, time_s: Array) -> None:
        """Typical distance of readings. Lost ones make none slow: an angle keeps the drive's rate, another channel
        the period that it had, until it is seen to be even at a lower rate."""
        known = self.time_s[-TAIL:]
        size = len(time_s) + len(known)
        span_s = float(time_s[-1]) - float(known[0] if len(known) else time_s[0])
        if size < 3 or abs(span_s / (size - 1) * self._rate_hz - 1.0) < 0.2:
            self.period_s = span_s / max(size - 1, 1) if size >= 3 else self.period_s
            self._kept_period_s = self.period_s if size >= EVIDENCE else self._kept_period_s
            self._distances_s = self._distances_s[:0]
        else:
            distances_s = np.diff(np.concatenate((known, time_s)))
            new = len(time_s) - (0 if len(known) else 1)
            self._distances_s = np.concatenate((self._distances_s, distances_s[-new:]))[-REMEMBERED:]
            self.period_s = self._own_period_s(_middle(distances_s))
        if not self.held and not self.calibration.angle and size >= 3:
            self.slow = self.period_s > SLOW_PERIODS / self._rate_hz

    def _own_period_s(self, newest_s: float) -> float:
        """The period of a channel that is not read at the drive's rate; `newest_s`: the middle of its newest ones."""
        even_s = self._even_s()
        if self.calibration.angle:
            return 1.0 / self._rate_hz if math.isnan(even_s) else even_s
        if not math.isnan(even_s):
            self._kept_period_s = even_s
        return newest_s if math.isnan(self._kept_period_s) else self._kept_period_s

    def _even_s(self) -> float:
        """The period that the newest readings keep; NaN where they do not show one."""
        distances_s = self._distances_s
        if len(distances_s) < EVIDENCE:
            return math.nan
        middle_s = _middle(distances_s)
        close = np.count_nonzero(distances_s * EVEN < middle_s)
        even = np.count_nonzero(distances_s < middle_s * EVEN) - close
        keeps = close <= CLOSE_SHARE * len(distances_s) and even >= EVEN_SHARE * len(distances_s)
        return middle_s if keeps else math.nan

    def forget(self, before_s: float) -> None:
        """Drop used samples, but keep `TAIL` of them for the next block."""
        used = int(self.time_s.searchsorted(before_s, side="left")) - TAIL if len(self.time_s) > TAIL else 0
        if used > 0:
            self.time_s, self.values, self.flaws = self.time_s[used:], self.values[used:], self.flaws[used:]


def _middle(values: Array) -> float:
    """The median of (n,) values, n >= 1, the lower one of two; a tenth of the cost of numpy's."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle])

"""Readings of one drive in, blocks out: calibrated, judged, on one time base.

A block is closed when every channel that is fast and alive has passed its end, or when the others have waited for it
long enough, so that a dead encoder stops nobody. Fast channels that share their stamps are placed as they are; the
block's time base then is the device's own. Other fast channels are interpolated onto it; slow ones are held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from edge_daemon.condition.calibration import Calibration
from edge_daemon.condition.flaw_watch import FlawWatch
from edge_daemon.condition.grating import without_warmth
from edge_daemon.condition.grid import Grid
from edge_daemon.condition.track import Track
from edge_daemon.config.settings import Drive
from edge_daemon.records import Block, Event, Flaw, Readings

HOLD_S = 0.25
"""A block waits this long for a channel that has fallen silent (guess: several times the jitter of a busy gateway)."""
REORDER_S = 0.02
"""Readings may arrive out of order by this and still be used (guess: UDP and USB adapters stay below)."""
LOOKAHEAD_PERIODS = 3.0
"""Interpolation at the end of a block needs the readings of so many periods after it."""
BEGIN_WITHIN_S = 1.0
"""The first block waits this long for an encoder that says nothing (guess: devices answer well within)."""
ATTENDED_S = HOLD_S / 2
"""No more than this, or a block's length, counts as waited between two looks: readings that came while the process
stood still are taken in a moment, and are no silence of their source."""
SILENT_AFTER_S = 1.0
"""A channel is told to be silent after this, or after `stale_after_s` if longer, while no blocks come (guess)."""


class Conditioner:
    """One drive. `push` may be called at any time between calls of `blocks`; nothing here blocks or reads a clock."""

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self._rate_hz = drive.rate_hz
        self._size = drive.block_samples
        self._tracks = tuple(Track(row, drive.rate_hz) for row in drive.channels)
        self._routes: dict[tuple[str, str], list[Track]] = {}
        for track in self._tracks:
            self._routes.setdefault((track.row.source, track.row.signal), []).append(track)
        self._order = sorted(self._tracks, key=_preference)
        self._gratings = [track for track in self._tracks if track.row.grating_nm is not None]
        self._followed = [(track, self._angles_beside(track)) for track in self._tracks]
        self._watch = FlawWatch(drive.name)
        self._start_s = math.nan  # of the next block, if nothing is missing
        self._sequence = 0
        self._gaps = 0
        self._ignored = 0
        self._due_s = math.nan
        self._arrival_s = math.nan  # when the newest reading was seen, on the attended clock
        self._looked_s = self._attended_s = math.nan
        self._most_attended_s = max(ATTENDED_S, drive.block_samples / drive.rate_hz)
        self._new_since_s = math.inf  # when the first reading of any channel was seen
        self._new = False

    def push(self, readings: Readings) -> None:
        """Take readings; those that feed no channel of this drive are ignored."""
        tracks = self._routes.get((readings.source, readings.signal))
        if tracks is None:
            self._ignored += 1
            return
        self._new = True
        for track in tracks:
            track.push(readings.time_s, readings.value)

    def blocks(self, now_s: float) -> list[Block]:
        """Completed blocks, oldest first; `math.inf` closes what is begun, for the end of a recording.

        Only differences of `now_s` between calls count, so the stamps of a replayed recording may be of another day.
        """
        now_s = self._attended(now_s)
        if self._new or math.isnan(self._arrival_s):
            self._arrival_s, self._new = now_s, False
        if not self._expected(now_s):
            return []
        for track in self._tracks:
            track.gather()
        if math.isnan(self._start_s) and not self._may_begin(now_s):
            return []
        found = []
        while (span := self._next_span()) is not None and self._due(span[1], now_s):
            found.append(self._close(*span))
            if not self._expected(now_s):
                break
        self._notice_silence(now_s)
        return found

    def take_events(self) -> list[Event]:
        """Flaws that set in or went away since the last call."""
        return self._watch.take()

    @property
    def stamp_failure(self) -> str:
        """Which angles have time stamps that jump, and by how much; empty for none."""
        jumps_s = {track.name: track.stamps.jump_s for track in self._tracks if track.stamps.jump_s}
        if not jumps_s:
            return ""
        size_ms = 1e3 * max(jumps_s.values())
        return f"{' and '.join(jumps_s)}: time stamps jump by {size_ms:.2g} ms: check trigger, clock and gateway"

    def counters(self) -> Mapping[str, int]:
        """Totals since the start: readings and their losses, blocks, gaps, and `<channel>.<flaw>` flawed samples."""
        totals: dict[str, int] = {"blocks": self._sequence, "gaps": self._gaps, "ignored": self._ignored}
        for track in self._tracks:
            for name, count in track.counts.items():
                totals[name] = totals.get(name, 0) + count
        return {**totals, **self._watch.counts}

    def age_s(self, channel: str, now_s: float) -> float:
        """Age of a channel's newest reading; inf before the first. Raises KeyError for an unknown channel."""
        track = next((track for track in self._tracks if track.name == channel), None)
        if track is None:
            raise KeyError(channel)
        return now_s - track.newest_s

    # when

    def _attended(self, now_s: float) -> float:
        """The clock by which readings are waited for: it does not run on while nobody looks."""
        if now_s == math.inf:
            return now_s
        if math.isnan(self._looked_s):
            self._attended_s = now_s
        else:
            self._attended_s += min(max(now_s - self._looked_s, 0.0), self._most_attended_s)
        self._looked_s = now_s
        return self._attended_s

    def _may_begin(self, now_s: float) -> bool:
        """The first block waits for every angle to be heard, but not for ever."""
        if self._new_since_s == math.inf and any(track.hint_s > -math.inf for track in self._tracks):
            self._new_since_s = now_s
        heard = all(track.first_s(-math.inf) < math.inf for track in self._tracks if track.calibration.angle)
        return heard or now_s - self._new_since_s > BEGIN_WITHIN_S

    def _expected(self, now_s: float) -> bool:
        """Whether to look for a block at all: the next one, if nothing is missing, can be closed, or none began yet."""
        return math.isnan(self._start_s) or self._due(self._start_s + self._size / self._rate_hz, now_s)

    def _next_span(self) -> tuple[float, float] | None:
        """Start and end of the next block; None while nothing has arrived for it."""
        period_s = 1.0 / self._rate_hz
        length_s = self._size * period_s
        started = not math.isnan(self._start_s)
        from_s = self._start_s - period_s / 2 if started else -math.inf
        first_s = min(track.first_s(from_s) for track in self._tracks)
        if first_s == math.inf:
            return None
        if not started:  # an encoder that answers 60 ms after the thermometer has lost nothing
            begun = [track.first_s(-math.inf) for track in self._tracks if track.calibration.angle]
            first_s = max([first_s, *(own_s - period_s for own_s in begun if own_s < math.inf)])
        if started and first_s < self._start_s + length_s - period_s / 2:
            return self._start_s, self._start_s + length_s
        for track in self._order:  # a new grid starts on a sample of the channel that will carry it
            own_s = track.first_s(first_s)
            if own_s < first_s + period_s:
                return own_s, own_s + length_s
        return first_s, first_s + length_s

    def _due(self, end_s: float, now_s: float) -> bool:
        """True where a block can be closed: all have passed its end, or the wait for the others is over."""
        passed_s = end_s + max(REORDER_S, LOOKAHEAD_PERIODS / self._rate_hz)
        behind_s = min([track.hint_s for track in self._tracks if track.awaited], default=-math.inf)
        if behind_s >= passed_s:
            return True
        newest_s = max([track.hint_s for track in self._tracks])
        if newest_s >= end_s and math.isnan(self._due_s):
            self._due_s = now_s
        waited_s = now_s - (self._arrival_s if newest_s < end_s else self._due_s) if now_s < math.inf else math.inf
        if waited_s < HOLD_S and newest_s < passed_s + HOLD_S:
            return False
        for track in self._tracks:
            track.awaited = track.awaited and track.hint_s >= end_s
        return True

    def _notice_silence(self, now_s: float) -> None:
        """While everything is silent no block tells that a channel is stale."""
        silent_s = now_s - self._arrival_s
        if not SILENT_AFTER_S < silent_s < math.inf:
            return
        for track in self._tracks:
            if silent_s > track.row.patience_s:
                self._watch.silent_or_flawed(track.name, Flaw.STALE, self._looked_s - silent_s, self._looked_s)

    # what

    def _close(self, start_s: float, end_s: float) -> Block:
        """The block from `start_s`, or from where its reference channel has it within half a sample period."""
        if not math.isnan(self._start_s) and start_s > self._start_s + 0.5 / self._rate_hz:
            self._gaps += 1
        self._advance(end_s)
        grid = Grid(start_s, self._rate_hz, self._size, self._order)
        aligned = {track.name: grid.align(track) for track in self._tracks}
        for track in self._gratings:
            gain, told = track.calibration.gain, aligned[track.name]
            aligned[track.name] = without_warmth(track.row, gain, told, aligned["temperature_degC"])
        self._start_s = grid.end_s
        self._due_s = math.nan
        self._sequence += 1
        for track in self._tracks:
            track.forget(grid.end_s - 0.5 / self._rate_hz)
            self._watch.see(track.name, aligned[track.name][1], grid.start_s, grid.end_s)
        return Block(
            self._drive.name,
            self._sequence,
            grid.start_s,
            self._rate_hz,
            {name: values for name, (values, _) in aligned.items()},
            {name: flaws for name, (_, flaws) in aligned.items()},
        )

    def _angles_beside(self, track: Track) -> list[Calibration]:
        """The drive's other angles, whose motion makes a value of this channel that stands still a frozen one."""
        if track.calibration.frozen_after_s is None:
            return []
        return [other.calibration for other in self._tracks if other is not track and other.calibration.angle]

    def _advance(self, end_s: float) -> None:
        """Calibrate all channels as far as this block needs."""
        until_s = end_s + LOOKAHEAD_PERIODS / self._rate_hz
        for track, angles in self._followed:
            moved_s = max([angle.moved_s for angle in angles], default=-math.inf)
            resets, jumps = track.calibration.resets, track.calibration.jumps[0]
            track.advance(end_s if track.slow else until_s, moved_s)
            if track.calibration.resets > resets:
                self._watch.reset(track.name, end_s, track.calibration.resets)
            if track.calibration.jumps[0] > jumps:
                self._watch.jump(track.name, end_s, *track.calibration.jumps)


def _preference(track: Track) -> int:
    """Whose grid a block takes: the output angle's, else another angle's, else the first channel's."""
    if track.name == "theta_out_rad":
        return 0
    return 1 if track.calibration.angle else 2

"""Alarms that neither flicker nor forget: hysteresis, delay, latching, acknowledgement (in the sense of ISA 18.2)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from edge_daemon.records import NE107, Event


class Finding(msgspec.Struct, frozen=True):
    """What a rule sees now. `high` raises the alarm, not even `low` lets it go; between the two it stays as it is."""

    key: str
    severity: NE107
    high: bool
    low: bool
    text: str
    """what is wrong and what to do, in a technician's words"""
    latching: bool = False
    """stays until acknowledged, even when the cause has gone"""
    delay_s: float = 0.0
    """the cause must last this long to raise, and be gone as long to clear"""


class Alarm(msgspec.Struct):
    key: str
    severity: NE107
    text: str
    latching: bool
    raised: bool = False
    acknowledged: bool = False
    since_s: float = 0.0
    """when it was raised"""
    changing_since_s: float | None = None
    """since when the cause has disagreed with `raised`"""
    gone: bool = False
    """the cause has cleared although the latch holds"""


class AlarmBook:
    """All alarms of one drive."""

    def __init__(self, drive: str) -> None:
        self.drive = drive
        self._alarms: dict[str, Alarm] = {}

    def update(self, now_s: float, findings: Iterable[Finding]) -> list[Event]:
        """Take what the rules see now; the events are the changes. A rule that says nothing counts as cleared."""
        seen = {finding.key: finding for finding in findings}
        events: list[Event] = []
        for key, finding in seen.items():
            known = self._alarms.get(key)
            if known is None and not finding.high:
                continue
            alarm = known or Alarm(key, finding.severity, finding.text, finding.latching)
            self._alarms[key] = alarm
            cause = finding.high if not alarm.raised or alarm.gone else finding.low
            if cause:
                alarm.text, alarm.severity = finding.text, finding.severity
            events += self._step(now_s, alarm, cause, finding.delay_s)
        for key, alarm in list(self._alarms.items()):
            if key not in seen:
                events += self._step(now_s, alarm, False, 0.0)
            if not alarm.raised and alarm.changing_since_s is None:
                del self._alarms[key]
        return events

    def _step(self, now_s: float, alarm: Alarm, cause: bool, delay_s: float) -> list[Event]:
        active = alarm.raised and not alarm.gone
        if cause == active:
            alarm.changing_since_s = None
            return []
        if alarm.changing_since_s is None or alarm.changing_since_s > now_s:
            alarm.changing_since_s = now_s
        if now_s - alarm.changing_since_s < delay_s:
            return []
        alarm.changing_since_s = None
        if cause:
            again = alarm.raised
            alarm.raised, alarm.gone, alarm.acknowledged, alarm.since_s = True, False, False, now_s
            return [self._event(now_s, alarm, alarm.severity, f"{alarm.text}{' (again)' if again else ''}")]
        alarm.gone = True
        if not alarm.latching or alarm.acknowledged:
            alarm.raised = False
            return [self._event(now_s, alarm, NE107.OK, f"cleared: {alarm.text}")]
        return []

    def acknowledge(self, now_s: float, key: str | None = None, who: str = "") -> list[Event]:
        """A person has seen the alarm `key`, or all; a latched one whose cause has gone is let go."""
        by = f" by {who}" if who else ""
        events = []
        for alarm in self._alarms.values():
            if not alarm.raised or alarm.acknowledged or key not in (None, alarm.key):
                continue
            alarm.acknowledged = True
            events.append(self._event(now_s, alarm, NE107.OK, f"acknowledged{by}: {alarm.text}"))
            alarm.raised = not alarm.gone
        self._alarms = {key: alarm for key, alarm in self._alarms.items() if alarm.raised or alarm.changing_since_s}
        return events

    @property
    def raised(self) -> Sequence[Alarm]:
        """Worst first, then oldest first."""
        rows = (alarm for alarm in self._alarms.values() if alarm.raised)
        return sorted(rows, key=lambda alarm: (-alarm.severity, alarm.since_s))

    def _event(self, now_s: float, alarm: Alarm, severity: NE107, message: str) -> Event:
        return Event(self.drive, now_s, severity, alarm.key, message)

    def state(self) -> bytes:
        """For a checkpoint: a latch survives a restart."""
        return msgspec.msgpack.encode((self.drive, list(self._alarms.values())))

    def restore(self, blob: bytes) -> bool:
        """True if taken over; False, and nothing changed, if broken or another drive's."""
        try:
            drive, alarms = msgspec.msgpack.decode(blob, type=tuple[str, list[Alarm]])
        except msgspec.MsgspecError:
            return False
        if drive != self.drive:
            return False
        for alarm in alarms:  # what was about to come or go has to last its time anew
            alarm.changing_since_s = None
        self._alarms = {alarm.key: alarm for alarm in alarms if alarm.raised}
        return True

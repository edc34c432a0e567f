"""Health of a drive: its NE 107 state, the reasons in a technician's words, and an index between 1 and 0."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from edge_daemon.channels import CHANNELS
from edge_daemon.health.alarms import AlarmBook, Finding
from edge_daemon.records import NE107, Estimate, Event, SourceHealth, Status
from edge_daemon.usage.bearing import HOT_CLEAR_DEGC, HOT_DEGC
from edge_daemon.usage.gears import Gear

SOFTER_WARN, SOFTER_CLEAR, SOFTER_LIMIT = 0.10, 0.08, 0.25
"""Stiffness lost: warn, clear the warning, limit of use (guess: 25 % halves the resonance margin of a usual servo)."""
USED_WARN, USED_CLEAR = 0.8, 0.75
"""A technician should know of this share of the flexspline's fatigue life, and no longer below the other."""
SOON_H, SOON_CLEAR_H = 720.0, 900.0
"""Remaining life that 90 % of such gears exceed: a month to order and fit a gear."""
FLAWED_HIGH, FLAWED_LOW = 0.5, 0.2
"""A channel with this share of samples that must not be used is flawed, and well again below the other."""
LOSING_HIGH, LOSING_LOW = 0.03, 0.015
"""So of an angle: the filters of motion reach over 200 samples, and at 3 % of losses one in 400 of them has none."""
DELAY_S = 5.0
"""A cause that lasts shorter than this is no alarm."""
FLAWED_S = 1.5
"""A channel that gives nothing for longer is told within three seconds of its fault, and a hiccup never."""
SLOW_DELAY_S = 60.0
"""A cause among quantities that change over days must last this long."""


@dataclass(frozen=True, slots=True)
class Health:
    """What `HealthJudge.judge` returns."""

    state: NE107
    reasons: tuple[str, ...]
    """most important first; empty when OK"""
    index: Estimate
    """`health_index`: 1 = as commissioned, 0 = at the limit of use"""
    events: tuple[Event, ...]
    """alarms that came, went or came again since the last call"""


class HealthJudge:
    """One per drive. `judge` as often as there is something new; alarms keep hysteresis, delay and latches between."""

    def __init__(self, drive: str, gear: Gear | None = None, source_of: Mapping[str, str] | None = None) -> None:
        """`source_of`: which source a channel comes from, so that a source that fails is told once, not per channel."""
        self.gear = gear
        self._source_of = source_of or {}
        self.alarms = AlarmBook(drive)
        self._slips: float | None = None

    def judge(
        self,
        now_s: float,
        estimates: Mapping[str, Estimate],
        sources: Sequence[SourceHealth] = (),
        flawed: Mapping[str, float] | None = None,
        findings: Sequence[Finding] = (),
    ) -> Health:
        """The drive's health now.

        `estimates` by the names of `quantities.QUANTITIES`, life included; `flawed` is the share of flawed samples per
        channel of the newest blocks, 0 to 1; `findings` are what other watchers (`trends`) have found.
        """
        mute = self._mute(sources, flawed or {})
        rules = (
            *_of_sources(sources, mute),
            *_of_channels(flawed or {}, {channel for channels in mute.values() for channel in channels}),
            *self._of_slips(estimates),
            *_of_load(estimates, self.gear),
            *_of_wear(estimates),
            *findings,
        )
        events = tuple(self.alarms.update(now_s, rules))
        raised = self.alarms.raised
        state = max((alarm.severity for alarm in raised), default=NE107.OK)
        reasons = tuple(f"{a.text}{'' if not a.gone else ' (over; acknowledge)'}" for a in raised)
        return Health(state, reasons, _index(now_s, estimates), events)

    def acknowledge(self, now_s: float, key: str | None = None, who: str = "") -> tuple[Event, ...]:
        """A person has seen the alarm `key`, or all of them; `who` goes into the events."""
        return tuple(self.alarms.acknowledge(now_s, key, who))

    def state(self) -> bytes:
        """For a checkpoint."""
        return self.alarms.state()

    def restore(self, blob: bytes) -> bool:
        """True if taken over; False, and nothing changed, if broken or another drive's."""
        return self.alarms.restore(blob)

    def _mute(self, sources: Sequence[SourceHealth], flawed: Mapping[str, float]) -> dict[str, list[str]]:
        """Channels of which nothing is left, by their source where it says itself that something is wrong."""
        ill = {source.source for source in sources if source.state in ("down", "degraded")}
        mute: dict[str, list[str]] = {}
        for channel, share in flawed.items():
            source = self._source_of.get(channel, "")
            if source in ill and share > FLAWED_HIGH:
                mute.setdefault(source, []).append(channel)
        return mute

    def _of_slips(self, estimates: Mapping[str, Estimate]) -> Iterator[Finding]:
        """Ratcheting since the last call. The first count seen after a start is where counting begins."""
        slips = _value(estimates, "ratcheting_events")
        if slips is None:
            return
        new = slips - (self._slips if self._slips is not None else slips)
        self._slips = slips
        text = (
            f"the gear has ratcheted ({slips:.0f} times so far): stop, find the overload, check that the teeth mesh "
            "centred (dedoidal), set the reference again"
        )
        yield Finding("ratcheting", NE107.FAILURE, new > 0, False, text, latching=True)


def _value(estimates: Mapping[str, Estimate], name: str) -> float | None:
    """The value of a usable estimate; None otherwise."""
    estimate = estimates.get(name)
    return estimate.value if estimate is not None and estimate.usable else None


def _of_sources(sources: Sequence[SourceHealth], mute: Mapping[str, Sequence[str]]) -> Iterator[Finding]:
    """`mute`: channels that a source no longer gives; of a bus with several devices it may be one that is missing."""
    for source in sources:
        why = source.reason or "no reason given"
        lost = ", ".join(mute.get(source.source, ()))
        down, poor = source.state == "down", source.state == "degraded"
        fault = "is down" if down or not lost else f"gives no usable {lost}"
        text = f"source {source.source} {fault} ({why}): check its power, cable and address"
        gone = down or bool(lost)
        yield Finding(f"source {source.source}", NE107.FUNCTION_CHECK, gone, gone, text, delay_s=FLAWED_S)
        poor = poor and not lost
        text = f"source {source.source} loses readings ({why}): check its cable, shield and termination"
        yield Finding(
            f"source {source.source} degraded", NE107.MAINTENANCE_REQUIRED, poor, poor, text, delay_s=SLOW_DELAY_S
        )


def _of_channels(flawed: Mapping[str, float], explained: Collection[str]) -> Iterator[Finding]:
    """`explained`: channels whose source has an alarm of its own for it; what is raised already stays raised."""
    for channel, share in flawed.items():
        text = f"channel {channel}: {share:.0%} of its samples cannot be used: check the sensor and its settings"
        angle = channel in CHANNELS and CHANNELS[channel].angle
        high, low = (LOSING_HIGH, LOSING_LOW) if angle else (FLAWED_HIGH, FLAWED_LOW)
        lost = share > high and channel not in explained
        yield Finding(f"channel {channel}", NE107.FUNCTION_CHECK, lost, share > low, text, delay_s=FLAWED_S)


def _of_load(estimates: Mapping[str, Estimate], gear: Gear | None) -> Iterator[Finding]:
    peak, mean = _value(estimates, "torque_peak"), _value(estimates, "torque_cubic_mean")
    worst = NE107.OUT_OF_SPECIFICATION
    for name, limit in gear.limits if gear else ():
        if peak is None or name == "repeated peak":
            continue
        text = (
            f"peak torque {peak:.0f} N m passed the {name} limit of {limit:.0f} N m: inspect the gear, lower the load"
        )
        yield Finding(f"torque {name}", worst, peak > limit, peak > 0.95 * limit, text, latching=True)
    if gear and gear.average_limit_Nm and mean is not None:
        limit = gear.average_limit_Nm
        text = f"mean torque {mean:.0f} N m is above the maker's {limit:.0f} N m: lower the load or take a larger gear"
        yield Finding("torque mean", worst, mean > limit, mean > 0.98 * limit, text, delay_s=SLOW_DELAY_S)
    warm = _value(estimates, "temperature")
    if warm is not None:
        text = f"housing at {warm:.0f} degC, grease fails above {HOT_DEGC:.0f}: lower speed or load, check lubricant"
        high, low = warm > HOT_DEGC, warm > HOT_CLEAR_DEGC
        yield Finding("temperature", worst, high, low, text, delay_s=SLOW_DELAY_S)


def _of_wear(estimates: Mapping[str, Estimate]) -> Iterator[Finding]:
    due = NE107.MAINTENANCE_REQUIRED
    change = _value(estimates, "stiffness_change")
    if change is not None:
        text = f"stiffness has changed by {change:+.1%} since commissioning: check bolts first, then plan a new gear"
        yield Finding(
            "stiffness", due, -change > SOFTER_WARN, -change > SOFTER_CLEAR, text, latching=True, delay_s=SLOW_DELAY_S
        )
    damage, p10 = _value(estimates, "damage"), _value(estimates, "rul_p10_h")
    if damage is not None:
        text = f"{damage:.0%} of the flexspline's fatigue life is used: order a spare gear"
        yield Finding("damage", due, damage > USED_WARN, damage > USED_CLEAR, text, delay_s=SLOW_DELAY_S)
    if p10 is not None:
        text = f"one gear in ten fails within {p10:.0f} h in this condition: plan its replacement"
        yield Finding("life", due, p10 < SOON_H, p10 < SOON_CLEAR_H, text, delay_s=SLOW_DELAY_S)


def _index(now_s: float, estimates: Mapping[str, Estimate]) -> Estimate:
    """The worst of what is known: life used and stiffness lost, each relative to its limit."""
    parts: list[tuple[float, float]] = []
    damage, change = estimates.get("damage"), estimates.get("stiffness_change")
    if damage is not None and damage.usable:
        parts.append((1.0 - damage.value, damage.sd))
    if change is not None and change.usable:
        parts.append((1.0 + min(change.value, 0.0) / SOFTER_LIMIT, change.sd / SOFTER_LIMIT))
    if not parts:
        return Estimate("health_index", math.nan, math.nan, "1", Status.WARMING_UP, now_s)
    value, sd = min(parts)
    return Estimate("health_index", min(max(value, 0.0), 1.0), sd, "1", Status.VALID, now_s)

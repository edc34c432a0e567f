"""Frames since the last look, sorted by message, and the readings they make."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np

from edge_daemon.acquire.can_decode import Decoded, Layout
from edge_daemon.acquire.canopen_objects import EMERGENCY_ID, EXTENDED, SYNC_ID
from edge_daemon.acquire.device_clock import DeviceClock
from edge_daemon.acquire.source import Tally
from edge_daemon.config.settings import CanStamp, SettingsError
from edge_daemon.records import Array, Readings

ERROR_BUS_OFF = 0x040
ERROR_CONTROLLER = 0x004
ERROR_RESTARTED = 0x100
"""The class of a Linux error frame (linux/can/error.h) stands in its identifier."""
CONTROLLER_OVERFLOW = 0x03
"""Byte 1 of a controller error frame says that a receive or transmit buffer of the controller overflowed."""
CONTROLLER_PASSIVE = 0x30
"""Byte 1 says that the controller is error-passive, receiving or transmitting."""
STRANGERS_KEPT = 4
"""So many identifiers that nobody asked for are kept, to name some."""
SYNCS_KEPT = 64
"""One read of a serial port holds no more SYNCs than this."""
SYNC_LASTS_S = 1.0
"""A frame this long after the last SYNC is no answer to it (guess: SYNC periods are milliseconds)."""


class Slot:
    """Where the frames of one message wait. Readers append whole payloads of `layout.length` bytes, and times."""

    __slots__ = ("clock", "data", "layout", "stamp", "synced", "times")

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.data: list[bytes] = []
        """payloads; one entry may hold several frames"""
        self.times: list[float] = []
        """arrival of each frame, wall clock"""
        self.stamp: str | None = None
        self.clock: DeviceClock | None = None
        self.synced = False
        """latched at SYNC, and taken for as old as that"""


class Inbox:
    """Filled by a reader on the event loop's thread, emptied into readings."""

    def __init__(
        self,
        source: str,
        layouts: Mapping[int, Layout],
        stamps: Iterable[CanStamp],
        tally: Tally,
        synced: Collection[int] = (),
    ) -> None:
        """`synced`: identifiers of the messages that were latched at SYNC.

        Raises `SettingsError` for a stamp of a message or signal that the layouts do not have.
        """
        self.slots = {key: Slot(layout) for key, layout in layouts.items()}
        self.frames = 0
        """taken since the last flush, whatever became of them"""
        self.source = source
        self._tally = tally
        self._clocks: dict[str, DeviceClock] = {}
        self._synchronised: deque[float] = deque(maxlen=SYNCS_KEPT)
        self._emergency: dict[int, int] = {}
        self._nodes = {EMERGENCY_ID + int(layout.name.split(":")[0]) for layout in layouts.values() if _is_pdo(layout)}
        self.trouble = ""
        """what the controller or a device complains of now; empty if nothing"""
        self.strangers: set[int] = set()
        """some identifiers that came and are in no table"""
        for stamp in stamps:
            self._stamp(stamp)
        for key in synced:
            self.slots[key].synced = True

    def _stamp(self, stamp: CanStamp) -> None:
        slot = next((slot for slot in self.slots.values() if slot.layout.name == stamp.message), None)
        signal = f"{stamp.message}.{stamp.signal}"
        if slot is None or signal not in [field.name for field in slot.layout.fields]:
            known = sorted(slot.layout.name for slot in self.slots.values())
            raise SettingsError(f"stamps: no signal {signal!r}: expected one of a message among {known}")
        slot.stamp = signal
        clock = self._clocks.get(stamp.clock)
        slot.clock = clock or DeviceClock(stamp.seconds_per_count, stamp.wrap_counts)
        self._clocks[stamp.clock] = slot.clock

    @property
    def all_stamped(self) -> bool:
        """Whether no reading depends on when its frame was read."""
        return all(slot.clock for slot in self.slots.values())

    def take(self, key: int, payload: bytes, time_s: float) -> None:
        """One data frame; `key` is its identifier, with `EXTENDED` for 29 bits."""
        self.frames += 1
        slot = self.slots.get(key)
        if slot is None:
            self._take_other(key, payload, time_s)
            return
        length = slot.layout.length
        if len(payload) < length:
            self._tally.count("truncated")
            return
        slot.data.append(payload if len(payload) == length else payload[:length])
        slot.times += self.latched(1, time_s) if slot.synced else (time_s,)

    def synchronised(self, time_s: float) -> None:
        """A SYNC went out, or came by. Callable from any thread."""
        self._synchronised.append(time_s)

    def latched(self, n: int, time_s: float) -> list[float]:
        """When the newest `n` frames of a synchronous message were latched, if they were read at `time_s`."""
        newest_s = self._synchronised[-1] if self._synchronised else -SYNC_LASTS_S
        if n == 1 and newest_s <= time_s:
            return [newest_s if time_s < newest_s + SYNC_LASTS_S else time_s]
        before = [sync_s for sync_s in tuple(self._synchronised) if time_s - SYNC_LASTS_S < sync_s <= time_s][-n:]
        return before if len(before) == n else [time_s] * n

    def _take_other(self, key: int, payload: bytes, time_s: float) -> None:
        if key == SYNC_ID:
            self.synchronised(time_s)
        elif key not in self._nodes:
            self._tally.count("unknown_ids")
            if len(self.strangers) < STRANGERS_KEPT:
                self.strangers.add(key & ~EXTENDED)
        elif len(payload) < 8:
            self._tally.count("truncated")
        else:  # CiA 301, emergency object: error code in the first two bytes, 0 = no error any more
            node, code = key - EMERGENCY_ID, int.from_bytes(payload[:2], "little")
            self._tally.count("emergencies", int(code != 0))
            self._emergency[node] = code
            found = [f"node {n} reports emergency 0x{c:04X}" for n, c in self._emergency.items() if c]
            self.trouble = "; ".join(found)

    def take_error(self, classes: int, payload: bytes) -> None:
        """One error frame: `classes` as Linux numbers them."""
        self.frames += 1
        self._tally.count("error_frames")
        if classes & ERROR_BUS_OFF:
            self._tally.count("bus_off")
            self.trouble = "bus-off: the controller has left the bus"
        elif classes & ERROR_RESTARTED:
            self.trouble = ""
        elif classes & ERROR_CONTROLLER and len(payload) > 1:
            if payload[1] & CONTROLLER_OVERFLOW:
                self._tally.count("controller_overflows")
            if payload[1] & ~CONTROLLER_OVERFLOW:  # an overflow alone says nothing of the controller's state
                self.trouble = "controller is error-passive" if payload[1] & CONTROLLER_PASSIVE else ""

    def take_malformed(self) -> None:
        """Something that is no frame."""
        self.frames += 1
        self._tally.count("malformed")

    @property
    def waits(self) -> bool:
        """Whether there is anything to decode."""
        return any(slot.times for slot in self.slots.values())

    def flush(self, shift_s: float, latest_s: float = math.inf) -> Iterator[Readings]:
        """One record per signal. `shift_s` brings arrival times onto the clock of the data.

        No arrival is later than `latest_s`, as it would seem where the wall clock was set back since.
        """
        self._tally.count("frames", self.frames)
        self.frames = 0
        for slot in self.slots.values():
            if slot.times:
                data, arrival_s = b"".join(slot.data), np.asarray(slot.times) + shift_s
                slot.data, slot.times = [], []
                yield from self._readings(slot, data, np.minimum(arrival_s, latest_s))

    def _readings(self, slot: Slot, data: bytes, arrival_s: Array) -> Iterator[Readings]:
        decoded = list(slot.layout.decode(data))
        time_s = arrival_s
        if slot.clock is not None:
            counts = next(values for field, values, _ in decoded if field.name == slot.stamp)
            jumps = slot.clock.jumps
            time_s = slot.clock.times(slot.layout.name, counts, arrival_s)
            self._tally.count("clock_jumps", slot.clock.jumps - jumps)
            if np.isnan(np.add.reduce(time_s)):
                yield from self._settled(slot, decoded, time_s)
                return
        for field, values, mask in decoded:
            if field.name == slot.stamp:
                continue
            if mask is None:
                yield Readings(self.source, field.name, time_s, values)
            elif mask.any():
                yield Readings(self.source, field.name, time_s[mask], values[mask])
        self._tally.count("readings", len(arrival_s))

    def _settled(self, slot: Slot, decoded: list[Decoded], time_s: Array) -> Iterator[Readings]:
        """What is left where the device's clock is not known, at the beginning or where it jumped back."""
        known = np.isfinite(time_s)
        self._tally.count("settling", int(np.count_nonzero(~known)))
        for field, values, mask in decoded:
            present = known if mask is None else known & mask
            if field.name != slot.stamp and present.any():
                yield Readings(self.source, field.name, time_s[present], values[present])


def _is_pdo(layout: Layout) -> bool:
    return layout.name.partition(":")[0].isdigit()

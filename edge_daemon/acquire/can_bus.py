"""A CAN interface as a source of readings."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import math
import os
import termios
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

from edge_daemon.acquire.can_decode import layouts_of
from edge_daemon.acquire.can_inbox import Inbox
from edge_daemon.acquire.can_pump import LOOK_EVERY_S, Pump, pump_in_thread
from edge_daemon.acquire.can_readers import (
    BusReader,
    FrameReader,
    LinkDown,
    SlcanReader,
    SocketReader,
)
from edge_daemon.acquire.can_sync import producing_sync
from edge_daemon.acquire.canopen_objects import EMERGENCY_ID, EXTENDED, SYNC_ID
from edge_daemon.acquire.canopen_setup import SDO_ANSWER_ID, NodeRefused, set_up
from edge_daemon.acquire.source import Sink, Tally, not_there
from edge_daemon.clock import Clock
from edge_daemon.config.settings import CanSource, SettingsError
from edge_daemon.records import SourceHealth

log = logging.getLogger(__name__)

SERIAL_PAUSE_S = 0.002
"""A look this long after the last catches every frame that a USB adapter hands over, for it does so every millisecond
or so."""
SOFTWARE_FILTERED = frozenset({"virtual", "slcan", "udp_multicast"})
"""On these interfaces python-can would filter frame by frame in Python; the table of known identifiers is cheaper."""
REOPENED_AFTER = 10.0
"""A serial adapter is opened anew after so many times `silent_after_s` (guess: a drive that rests sends less often)."""
CAN_TYPE = "280\n"
"""The kernel calls an interface so that carries CAN (ARPHRD_CAN of linux/if_arp.h)."""
NEVER_RESETS = "/dev/pts/"
"""A pseudo terminal is no microcontroller that needs seconds to start after its port was opened."""


class CanBus:
    """Opens the interface with python-can, reads it on the event loop, decodes in batches."""

    def __init__(self, settings: CanSource, base: Path) -> None:
        """Raises `SettingsError` if the decoding does not fit together."""
        self.name = settings.name
        self._settings = settings
        self._tally = Tally(settings.name)
        try:
            _check_interface(settings.interface)
            self._layouts = layouts_of(settings, base)
            self._inbox = self._new_inbox()
        except SettingsError as error:
            raise SettingsError(f"can {settings.name!r}: {error}") from error
        self._clock: Clock | None = None
        self._heard_s = 0.0

    def _new_inbox(self) -> Inbox:
        produces = self._settings.sync_period_s is not None
        synced = {
            pdo.cob_id for pdo in self._settings.pdo if (produces if pdo.synchronous is None else pdo.synchronous)
        }
        return Inbox(self.name, self._layouts, self._settings.stamps, self._tally, synced)

    async def run(self, sink: Sink, clock: Clock) -> None:
        """See `Source.run`."""
        self._clock, self._heard_s = clock, clock.time_s()
        held = self._claim()
        try:
            await self._listen(sink, clock)
        finally:
            if held is not None:
                os.close(held)

    async def _listen(self, sink: Sink, clock: Clock) -> None:
        bus = await _open_off_loop(self._open)
        try:
            self._inbox = self._new_inbox()
            self._tally.count("opened")
            self._tally.set("ok")
            with self._synchronised(bus):
                await self._read(bus, sink, clock)
        except LinkDown as error:
            self._deliver(sink, clock)
            raise self._tally.lost(str(error)) from error
        finally:
            await asyncio.to_thread(_close, bus)

    def health(self) -> SourceHealth:
        """See `Source.health`. A bus without a known frame for `silent_after_s`, or in error, is degraded."""
        now = self._tally.health()
        if now.state != "ok" or self._clock is None:
            return now
        reason = self._inbox.trouble
        silent_s = self._clock.time_s() - self._heard_s
        if silent_s > self._settings.silent_after_s:
            reason = "; ".join(filter(None, (reason, f"no known frame for {silent_s:.1f} s{self._instead()}")))
        state = "degraded" if reason else "ok"
        return SourceHealth(now.source, state, reason, now.last_s, now.counters)

    def _instead(self) -> str:
        """What else is on a bus that has never given a known frame, as far as it is let through to here."""
        if math.isfinite(self._tally.last_s):
            return ""
        others = ", ".join(f"0x{key:X}" for key in sorted(self._inbox.strangers))
        if others:
            return f", but others such as {others}: does {'dbc' if self._settings.dbc else 'pdo'} describe this bus?"
        return " nor any other: bit rate, termination, power?" if self._settings.interface in SOFTWARE_FILTERED else ""

    def _open(self) -> Any:
        """The python-can bus, its nodes set up where that is allowed. Blocks. Raises `SourceLost`."""
        settings = self._settings
        options: dict[str, Any] = {}
        if settings.interface not in SOFTWARE_FILTERED:
            options["can_filters"] = self._filters()
        if settings.interface == "socketcan" and any(layout.length > 8 for layout in self._layouts.values()):
            options["fd"] = True
        bus = None
        try:
            bus = open_interface(settings, **options)
            set_up(bus, settings)
        except (LinkDown, NodeRefused) as error:
            if bus is not None:
                _close(bus)
            raise self._tally.lost(str(error)) from error
        if settings.interface == "slcan":
            with contextlib.suppress(OSError):
                fcntl.ioctl(bus.fileno(), termios.TIOCEXCL)  # others fail to open it, unless they may do anything
        return bus

    def _claim(self) -> int | None:
        """A lock on a serial adapter, held as long as this descriptor is open: whoever else opened the adapter would
        close the bus for both, without a word. Raises `SourceLost`; None for what is no serial adapter."""
        port = self._settings.channel.partition("@")[0]
        if self._settings.interface != "slcan" or "://" in port:
            return None
        held = -1
        try:
            held = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(held)
            raise self._tally.lost(f"{port}: another process has this adapter open") from error
        except OSError as error:
            raise self._tally.lost(f"cannot open slcan:{port}: {not_there(port) or _why(error)}") from error
        return held

    def _filters(self) -> list[dict[str, Any]] | None:
        """Exactly the identifiers that can be decoded; with process data SYNC, and their nodes' emergencies."""
        others = {EMERGENCY_ID + pdo.node for pdo in self._settings.pdo} | ({SYNC_ID} if self._settings.pdo else set())
        if self._settings.map_pdos:
            others |= {SDO_ANSWER_ID + pdo.node for pdo in self._settings.pdo}
        return [
            {
                "can_id": key & ~EXTENDED,
                "can_mask": 0x1FFF_FFFF if key & EXTENDED else 0x7FF,
                "extended": bool(key & EXTENDED),
            }
            for key in sorted({*self._layouts, *others})
        ] or None

    def _synchronised(self, bus: Any) -> contextlib.AbstractContextManager[None]:
        """Produces SYNC while it lasts, if so configured."""
        if self._settings.sync_period_s is None:
            return contextlib.nullcontext()
        by_kernel = self._settings.interface == "socketcan"
        return producing_sync(bus, self._settings.sync_period_s, self._inbox.synchronised, by_kernel=by_kernel)

    async def _read(self, bus: Any, sink: Sink, clock: Clock) -> None:
        """Until cancelled. Raises `LinkDown`."""

        def deliver() -> None:
            self._deliver(sink, clock)

        descriptor, limit = _descriptor(bus), self._settings.frames_per_wakeup
        if descriptor is None:
            await pump_in_thread(BusReader(bus), self._inbox, limit, deliver)
            return
        reader = self._reader(bus, descriptor)
        timed = reader.stamps_itself or self._inbox.all_stamped
        pause_s = LOOK_EVERY_S if timed else SERIAL_PAUSE_S
        pumping = Pump(reader, self._inbox, limit, pause_s, deliver).run(descriptor)
        await (self._while_heard(pumping, clock) if self._settings.interface == "slcan" else pumping)

    async def _while_heard(self, pumping: Coroutine[Any, Any, None], clock: Clock) -> None:
        """A serial adapter that was closed by somebody else, or hangs, is silent for ever: opening it anew helps."""
        task = asyncio.ensure_future(pumping)
        longest_s = REOPENED_AFTER * self._settings.silent_after_s
        try:
            while not task.done():
                await asyncio.wait([task], timeout=self._settings.silent_after_s)
                silent_s = clock.time_s() - self._heard_s
                if not task.done() and silent_s > longest_s:
                    raise LinkDown(f"no known frame for {silent_s:.0f} s{self._instead()}: the adapter is opened anew")
            await task
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError, LinkDown):
                await task

    def _reader(self, bus: Any, descriptor: int) -> FrameReader:
        from can import CanError

        try:
            if self._settings.interface == "socketcan":
                return SocketReader(bus.socket, self._settings.receive_buffer_bytes, self._tally)
            if self._settings.interface == "slcan":
                # what waited in the port would seem to arrive now
                bus.flush()
                return SlcanReader(descriptor, self._inbox)
        except (OSError, CanError) as error:
            raise LinkDown(f"cannot set up: {error}") from error
        return BusReader(bus)

    def _deliver(self, sink: Sink, clock: Clock) -> None:
        known, wall_s, now_s = self._inbox.waits, time.time(), clock.time_s()
        for readings in self._inbox.flush(clock.from_wall_s(wall_s) - wall_s, now_s):
            sink(readings)
        if known:
            self._heard_s = self._tally.last_s = now_s


def open_interface(settings: CanSource, **options: Any) -> Any:
    """The python-can bus of a section. Blocks. Raises `LinkDown`, which names the interface."""
    import can

    # it logs each failed attempt, all night; what it then raises is told once
    logging.getLogger("can").setLevel(logging.CRITICAL)
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    if settings.interface == "slcan" and str(Path(settings.channel).resolve()).startswith(NEVER_RESETS):
        options["sleep_after_open"] = 0.0
    where = f"{settings.interface}:{settings.channel}"
    port = settings.channel.partition("@")[0]
    missing = not_there(port) if settings.interface == "slcan" else ""
    if missing:
        raise LinkDown(f"cannot open {where}: {missing}")
    try:
        return can.Bus(channel=settings.channel, interface=settings.interface, ignore_config=True, **options)
    except Exception as error:  # a driver without its library fails in its own way, some with a NameError
        raise LinkDown(f"cannot open {where}: {_why(error)}{_interfaces(settings)}") from error


def _interfaces(settings: CanSource) -> str:
    """Which CAN interfaces there are, where the one that is asked for is not."""
    if settings.interface != "socketcan" or Path(f"/sys/class/net/{settings.channel}").exists():
        return ""
    there = sorted(path.parent.name for path in Path("/sys/class/net").glob("*/type") if path.read_text() == CAN_TYPE)
    return f": there {'are ' + ', '.join(there) if there else 'is no CAN interface at all: `ip link` shows all'}"


def _why(error: Exception) -> str:
    """One line. A port's own message says number, name and reason twice; the system's word for it is enough."""
    number = next((e.errno for e in (error, error.__cause__) if isinstance(e, OSError) and e.errno), None)
    if number is not None:
        return os.strerror(number)
    said = next(iter(str(error).splitlines()), "").rstrip(".")
    return f"{said}: is its driver installed?" if isinstance(error, NameError) else said or type(error).__name__


def _check_interface(name: str) -> None:
    from can.interfaces import BACKENDS

    if name not in BACKENDS:
        raise SettingsError(f"interface: {name!r} is unknown: expected one of {sorted(BACKENDS)}")


async def _open_off_loop(open_: Callable[[], Any]) -> Any:
    """The result of a blocking opener; closed again if the caller is cancelled meanwhile."""
    opening = asyncio.ensure_future(asyncio.to_thread(open_))
    try:
        return await asyncio.shield(opening)
    except asyncio.CancelledError:
        opening.add_done_callback(lambda done: None if done.cancelled() or done.exception() else _close(done.result()))
        raise


def _close(bus: Any) -> None:
    try:
        bus.shutdown()
    except Exception as error:  # a dead interface fails in a different way per driver; it is closed either way
        log.debug("closing a bus: %s", error)
        port = getattr(bus, "serialPortOrig", None)  # python-can leaves the port open if saying goodbye to it fails
        if port is not None:
            port.close()


def _descriptor(bus: Any) -> int | None:
    from can import CanError

    try:
        descriptor = int(bus.fileno())
    except (NotImplementedError, OSError, CanError):
        return None
    return descriptor if descriptor >= 0 else None

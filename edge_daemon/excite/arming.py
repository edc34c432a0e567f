"""Who may start a motion, and who keeps it going: both configuration and person, before and all the time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from edge_daemon.config.settings import Drive, Excite
from edge_daemon.errors import BadInput


class NotArmed(BadInput):
    """One line: what is missing before this drive may be moved."""


@dataclass(frozen=True, slots=True)
class Armed:
    """Leave to move one drive. Only `arm` makes it."""

    drive: str
    excite: Excite


def arm(drive: Drive, typed: str | None) -> Armed:
    """Leave to move `drive`: its configuration must allow it and `typed` must be its name. Raises `NotArmed`."""
    if drive.excite is None or not drive.excite.allowed:
        raise NotArmed(f"drive {drive.name!r}: not armed: expected `allowed = true` in its [drive.excite]")
    if typed != drive.name:
        raise NotArmed(
            f"drive {drive.name!r}: not armed: expected its name typed after --arm, got {typed or 'nothing'!r}"
        )
    return Armed(drive.name, drive.excite)


class DeadMan:
    """A sign of life that the operator must keep giving; without it the motion ends."""

    def __init__(self, timeout_s: float, now: Callable[[], float]) -> None:
        self._timeout_s = timeout_s
        self._now = now
        self._given_s = now()
        self._released = False

    def give(self) -> None:
        """One sign of life. Safe from any thread."""
        self._given_s = self._now()

    def release(self) -> None:
        """End at once, for good."""
        self._released = True

    @property
    def gone(self) -> str:
        """Why the operator counts as gone; empty while present."""
        if self._released:
            return "the operator let go"
        silent_s = self._now() - self._given_s
        return f"no sign of life from the operator for {silent_s:.2g} s" if silent_s > self._timeout_s else ""


def follow(lines: Iterable[str], dead_man: DeadMan) -> threading.Thread:
    """A thread that takes each line as a sign of life, and the end of the stream (a lost terminal) as letting go."""

    def read() -> None:
        try:
            for _ in lines:
                dead_man.give()
        finally:
            dead_man.release()

    thread = threading.Thread(target=read, name="dead-man", daemon=True)
    thread.start()
    return thread

"""The guarded loop: one command per cycle, and a stop on any doubt.

Runs in the thread that calls it and nowhere else: the targets, the SYNC and the heartbeat that the drive watches all
come from this one loop, after its checks. If the loop hangs or the process dies, the drive hears nothing and stops.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from msgspec import structs

from edge_daemon.clock import Clock
from edge_daemon.excite.arming import Armed, DeadMan
from edge_daemon.excite.drive_link import LinkLost
from edge_daemon.excite.limits import Doubt, Feedback, LimitError, check_profile, temperature_problem
from edge_daemon.excite.profiles import PlannedMotion
from edge_daemon.excite.sequence import QUICK_STOP, Command, Outcome, Sequence, Stage
from edge_daemon.records import Readings

log = logging.getLogger(__name__)

MARKS_PER_RECORD = 50
LAST_TRIES = 5
"""So many quick stop commands are sent on a bus that has just failed, a cycle apart, for a full buffer empties itself;
after them the drive stops by our silence."""


class Link(Protocol):
    """What the loop needs of a drive; `drive_link.CanopenDrive` is the real one."""

    def prepare(self) -> Feedback: ...

    def feedback(self) -> Feedback | None: ...

    def send(self, command: Command) -> None: ...

    def standing(self) -> bool: ...

    def release(self) -> None: ...


def unknown() -> float:
    """The temperature where nobody measures it."""
    return float("nan")


def no_doubt() -> str:
    """Nobody else doubts."""
    return ""


@dataclass(slots=True)
class Runner:
    """One run of a course on one drive."""

    armed: Armed
    link: Link
    dead_man: DeadMan
    clock: Clock
    """stamps the phase marks"""
    now: Callable[[], float]
    """monotonic [s]"""
    wait: Callable[[float], None]
    """sleep for so many seconds"""
    temperature_degC: Callable[[], float] = unknown
    """newest gear temperature; NaN when unknown or stale"""
    doubts: Callable[[], str] = no_doubt
    """what else forbids motion (a stale output encoder, say); empty when nothing does"""
    mark: Callable[[Readings], None] = lambda _readings: None
    """takes the phase marks: source `excite`, signal `<drive>.profile_phase`"""
    cycles: int = 0
    latest_s: float = 0.0
    """the latest cycle so far"""
    _stamps: list[float] = field(default_factory=list)
    _phases: list[int] = field(default_factory=list)
    _steps: int = 0
    _last_rad: float = 0.0
    _unmarked: str = ""

    def run(self, course: PlannedMotion) -> Outcome:
        """Check, enable, move, stop. Returns how it ended; the drive is stopped or has been left to stop itself.

        Raises `LimitError` or `drive_link.DriveRefused` before anything moves. An exception from within the loop ends
        in a stop first and is then raised again.
        """
        settings = self.armed.excite
        temperature = self.temperature_degC()
        anywhere = structs.replace(settings.limits, minimum_rad=None, maximum_rad=None)
        check_profile(course, 0.0, anywhere, temperature)
        seen = self.link.prepare()
        try:
            check_profile(course, seen.position_rad, settings.limits, temperature)
        except LimitError:
            self.link.release()
            raise
        sequence = Sequence(settings, course, seen.position_rad, self.now())
        self._last_rad = seen.position_rad
        self._steps = self._clock_steps()
        try:
            failure = self._cycle_until_over(sequence)
        except LinkLost as lost:
            return self._lost(sequence, str(lost))
        finally:
            self._flush()
        if sequence.stopped or self.link.standing():
            sequence.stopped = True
            self.link.release()
        if failure is not None:
            raise failure
        return sequence.outcome

    def _cycle_until_over(self, sequence: Sequence) -> BaseException | None:
        """Each cycle; the first exception that was not the bus's, after the stop that it led to."""
        cycle_s = self.armed.excite.cycle_s
        failure: BaseException | None = None
        due_s = self.now()
        while sequence.stage is not Stage.OVER:
            try:
                now_s = self.now()
                self._one(sequence, now_s, now_s - due_s)
                due_s = max(due_s + cycle_s, now_s)  # late: the course goes on from here, it never leaps
                self.wait(due_s - self.now())
            except LinkLost:
                raise
            except BaseException as error:  # KeyboardInterrupt too: nothing may leave a drive in motion
                if failure is not None:
                    log.exception("again while stopping")
                    raise LinkLost(f"the guarded loop failed twice: {error}") from failure
                failure = error
                sequence.end(f"the guarded loop failed: {type(error).__name__}: {error}", self.now())
        return failure

    def _one(self, sequence: Sequence, now_s: float, late_s: float) -> None:
        self.cycles += 1
        self.latest_s = max(self.latest_s, late_s)
        moving = sequence.stage in (Stage.ENABLING, Stage.MOVING, Stage.RAMPING)
        doubt = self._doubt(late_s) if moving else None
        command = sequence.step(now_s, self.link.feedback(), doubt)
        self._last_rad = command.position_rad
        self.link.send(command)
        self._note(command.phase)

    def _doubt(self, late_s: float) -> Doubt | None:
        settings = self.armed.excite
        if late_s > settings.late_s:
            return Doubt(f"a cycle came {late_s * 1e3:.0f} ms late: limit {settings.late_s * 1e3:.0f} ms", hard=True)
        if self._clock_steps() != self._steps:
            return Doubt("the clock jumped: the marks of this motion would lie", hard=False)
        reason = (
            self._unmarked
            or self.dead_man.gone
            or temperature_problem(settings.limits, self.temperature_degC())
            or self.doubts()
        )
        return Doubt(reason, hard=False) if reason else None

    def _clock_steps(self) -> int:
        self.clock.time_s()
        return self.clock.steps_forward + self.clock.steps_back

    def _lost(self, sequence: Sequence, reason: str) -> Outcome:
        """The bus is gone: say quick stop a few times in case it is heard, then be silent."""
        stop = Command(QUICK_STOP, self._last_rad, 0.0, heartbeat=False, phase=0)
        for _ in range(LAST_TRIES):
            try:
                self.link.send(stop)
            except Exception as error:  # whatever it is, the next try may be heard
                log.debug("a last quick stop was not sent: %s", error)
            self.wait(self.armed.excite.cycle_s)
        heartbeat_ms = self.armed.excite.heartbeat_s * 1e3
        ending = f"{reason}; the drive, no longer hearing this gateway, stops itself within {heartbeat_ms:.0f} ms"
        return Outcome(False, False, f"{sequence.reason}; {ending}" if sequence.reason else ending)

    def _note(self, phase: int) -> None:
        self._stamps.append(self.clock.time_s())
        self._phases.append(phase)
        if len(self._stamps) >= MARKS_PER_RECORD:
            self._flush()

    def _flush(self) -> None:
        if self._stamps:
            stamps, phases = np.array(self._stamps), np.array(self._phases, dtype=np.float64)
            self._stamps, self._phases = [], []
            try:
                self.mark(Readings("excite", f"{self.armed.drive}.profile_phase", stamps, phases))
            except Exception as error:  # a full disk or a closed terminal: no reason to lose the loop as well
                log.exception("the marks of the motion are lost")
                self._unmarked = f"the motion can no longer be marked: {type(error).__name__}: {error}"

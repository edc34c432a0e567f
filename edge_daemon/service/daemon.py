"""Everything wired, left to right: sources -> pipelines -> store and outlets. The only module that knows all stages.

Each source, drive and outlet is a task of the supervisor: one that fails is restarted alone, the others go on.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import signal
import sys
import time
from asyncio.subprocess import DEVNULL
from collections import deque
from collections.abc import Callable
from pathlib import Path

from edge_daemon import __version__
from edge_daemon.acquire.drivers import open_source
from edge_daemon.acquire.i2c import I2cBus
from edge_daemon.acquire.source import Source
from edge_daemon.clock import Clock
from edge_daemon.config.settings import Drive, Settings
from edge_daemon.errors import BadInput
from edge_daemon.integrator import machine_code
from edge_daemon.prognose.forecast import Forecast
from edge_daemon.records import NE107, Bands, Burst, Event, GatewayState, Readings, Snapshot
from edge_daemon.service.configuration import examined
from edge_daemon.service.drive_view import drive_view, what_if
from edge_daemon.service.history import History
from edge_daemon.service.log_limit import begin_log
from edge_daemon.service.model_versions import change_version, checked_formula, versions
from edge_daemon.service.notify import Notifier
from edge_daemon.service.outputs import Outputs
from edge_daemon.service.pipeline import Pipeline, open_pipeline
from edge_daemon.service.priors import PriorInbox, key_of
from edge_daemon.service.spectrogram import sound_picture
from edge_daemon.service.supervisor import Supervisor
from edge_daemon.service.uploaded_columns import keep_columns, preview
from edge_daemon.show.jobs import bounded
from edge_daemon.show.page_api import PageApi
from edge_daemon.text import said

log = logging.getLogger(__name__)

TURN_EVERY_S = 0.2
"""A drive's loop turns this often: judging the state and writing the registers costs as much for two blocks as for one,
and a PLC that asks ten times a second sees data no older than the block and this."""
PUBLISH_EVERY_S = 1.0
"""The fleet and the store are told so often; a PLC's registers follow every turn."""
SOUND_SHARE = 0.05
"""Of the store the sound that is kept may take so much, all drives together (guess)."""
CHECKPOINT_EVERY_S = 10.0
"""A power cut may cost so much of what was learned."""
STOP_WITHIN_S = 8.0
"""The daemon stops within this, of the 15 s that the unit grants."""
LEAST_COMMIT_S = 1.0
"""One commit a second at most, whatever happens."""
EVENTS_KEPT = 200
"""So many of the newest events are in memory for the page; the store keeps the rest."""
LATE_AFTER_S = 10.0
"""A loop that has not turned for this long no longer feeds the watchdog (half of the unit's WatchdogSec)."""


def commit_within_s(age_s: float, usual_s: float) -> float:
    """How long a run of this age waits with its next commit: a cut then costs at most half of a young one."""
    return min(usual_s, max(LEAST_COMMIT_S, age_s / 2))


class Daemon:
    """The daemon as one object: `await Daemon(path).run()`."""

    def __init__(
        self, file: Path, i2c_bus: Callable[[int | str], I2cBus] | None = None, clock: Clock | None = None
    ) -> None:
        self.file = file
        self.settings = examined(file, i2c_bus is not None)
        self.clock = clock or Clock()
        self._i2c_bus = i2c_bus
        self._notifier = Notifier()
        self._supervisor = Supervisor()
        self._stop = asyncio.Event()
        self._hangup = asyncio.Event()
        self._happened = asyncio.Event()
        self._sources = {row.name: open_source(row, file.parent, i2c_bus) for row in self.settings.sources}
        self._pipelines: dict[str, Pipeline] = {}
        self._snapshots: dict[str, Snapshot] = {}
        self._beats: dict[str, float] = {}
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._reasons: dict[str, str] = {}
        self._on_probation: set[str] = set()
        self._started_s = self.clock.time_s()
        self.history = History(self.settings.store, file.parent)
        self._priors = PriorInbox(key_of(self.settings.zenoh, file.parent))
        self._outputs = Outputs(
            self.settings,
            self.state,
            self.history.answer,
            self.clock,
            self._page_api(),
            keep=self.history.add_messages,
            on_prior=lambda envelope: self._priors.hear(envelope),
        )

    async def run(self) -> None:
        """Until SIGTERM, SIGINT or `stop()`. SIGHUP reads the configuration again."""
        self._listen_to_signals()
        self._tell_store_notes()
        for drive in self.settings.drive:
            self._start_drive(drive)
        for source in self._sources.values():
            self._start_source(source)
        self._outputs.start(self._supervisor)
        self._supervisor.start("store", self._keep)
        self._supervisor.start("watchdog", self._watch)
        compiling = asyncio.create_task(self._compile())
        self._supervisor.start("reload", self._follow_hangups)
        self._notifier.send(READY=1, STATUS="measuring")
        log.info("ready: %d drives, %d sources", len(self.settings.drive), len(self._sources))
        await self._stop.wait()
        compiling.cancel()
        await self._shut_down()
        await asyncio.wait({compiling}, timeout=STOP_WITHIN_S)

    @property
    def store_file(self) -> Path:
        """Where the ring buffer is."""
        return self.history.file

    def stop(self) -> None:
        """Ask `run` to end in order."""
        self._stop.set()

    def state(self) -> GatewayState:
        """What the page and the metrics show."""
        gateway = self.settings.gateway
        return GatewayState(
            site=gateway.site,
            gateway=gateway.name,
            version=__version__,
            started_s=self._started_s,
            now_s=self.clock.time_s(),
            snapshots=dict(self._snapshots),
            sources=tuple(source.health() for source in self._sources.values()),
            tasks=self._supervisor.health(),
            events=tuple(self._events),
            links=(*self._outputs.health(), self.history.health()),
        )

    # what the page may see and do

    def _page_api(self) -> PageApi:
        return PageApi(
            drive_view=lambda drive: drive_view(self._pipelines[drive]) if drive in self._pipelines else None,
            what_if=lambda drive, factor: what_if(self._running(drive).life, factor),
            history=self.history.history,
            trend=self.history.trend,
            sound=lambda drive, asked: sound_picture(self.store_file, drive, asked),
            newest_s=self.history.newest_s,
            flush=self.history.commit,
            sharing=self._sharing,
            columns=preview,
            keep_columns=keep_columns,
            versions=versions,
            change_version=change_version,
            formula=checked_formula,
            events=self.history.events,
            acknowledge=self._acknowledge,
            model_file=lambda drive: self._pipelines[drive].model_file if drive in self._pipelines else None,
            folder=self.file.parent,
            store=self.store_file,
        )

    def _sharing(self, drive: str) -> list[str]:
        """Drives with the model file of this one, where it is not alone."""
        files = {name: pipeline.model_file.resolve() for name, pipeline in self._pipelines.items()}
        same = [name for name, file in files.items() if file == files.get(drive)]
        return same if len(same) > 1 else []

    def _running(self, drive: str) -> Pipeline:
        if drive not in self._pipelines:
            raise BadInput(f"drive {drive!r}: expected one of {', '.join(self._pipelines)}")
        return self._pipelines[drive]

    def _acknowledge(self, drive: str, key: str | None, who: str) -> int:
        events = self._running(drive).acknowledge(self.clock.time_s(), key, who)
        self._tell_all(events)
        return len(events)

    # starting and stopping

    def _start_source(self, source: Source) -> None:
        self._sources[source.name] = source
        self._supervisor.start(f"source {source.name}", lambda: source.run(self._deliver, self.clock))

    def _start_drive(self, drive: Drive) -> None:
        self._beats[drive.name] = time.monotonic()
        self._supervisor.start(f"drive {drive.name}", lambda: self._work(drive))

    async def _stop_source(self, name: str) -> None:
        await self._supervisor.stop(f"source {name}")
        self._sources.pop(name, None)

    async def _stop_drive(self, name: str) -> None:
        await self._supervisor.stop(f"drive {name}")
        self._beats.pop(name, None)
        self._snapshots.pop(name, None)

    async def _shut_down(self) -> None:
        """Sources and drives end, drives leave their checkpoints; then the fleet is told; the store closes last."""
        self._notifier.send(STOPPING=1, STATUS="storing what was learned")
        late = await self._supervisor.stop_all(STOP_WITHIN_S)
        for name in late:
            log.warning("%s did not end in %.0f s", name, STOP_WITHIN_S)
        await asyncio.to_thread(self._outputs.close)
        await asyncio.to_thread(self.history.close)
        log.info("stopped")

    def _listen_to_signals(self) -> None:
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.stop)
        loop.add_signal_handler(signal.SIGHUP, self._hangup.set)

    async def _compile(self) -> None:
        """Once per version, the integrator is compiled by a child: ten seconds of computing. Until it is there, drives
        are told from the balance of torques."""
        if machine_code.library().exists():
            return
        machine_code.compiled_elsewhere(True)
        try:
            made = await self.compile_in_a_child()
            if made:
                await asyncio.to_thread(machine_code.load)
        except asyncio.CancelledError:  # nobody makes it any more: this process may by itself
            machine_code.compiled_elsewhere(False)
            raise
        if made:
            machine_code.compiled_elsewhere(False)
        else:
            log.warning("the integrator could not be compiled: laws are told from the balance of torques alone")

    async def compile_in_a_child(self) -> bool:
        """Whether the child came to its end; it does not outlive this task."""
        command = bounded(sys.executable, "-m", machine_code.__name__)
        child = await asyncio.create_subprocess_exec(*command, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL)
        try:
            return await child.wait() == 0
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()

    # the work

    def _deliver(self, record: Readings | Burst | Bands) -> None:
        for pipeline in self._pipelines.values():
            pipeline.push(record)

    async def _work(self, drive: Drive) -> None:
        """One drive's loop. After an exception the supervisor calls again: a new pipeline from the last checkpoint."""
        self._beats[drive.name] = time.monotonic()
        try:
            await self._measure(drive)
        except Exception as error:
            self._give_up(drive.name, str(error) or type(error).__name__)
            raise

    def _give_up(self, drive: str, why: str) -> None:
        """The last good state of a drive must not stand while nobody works on it."""
        before = self._snapshots.get(drive)
        time_s, sequence = (before.time_s, before.sequence) if before else (math.nan, 0)
        reason = f"nothing is estimated: {why}: it is tried again"
        self._snapshots[drive] = Snapshot(drive, sequence, time_s, NE107.FAILURE, (reason,), {})
        self._outputs.publish(self._snapshots[drive])

    async def _measure(self, drive: Drive) -> None:
        sound_bytes = SOUND_SHARE * self.settings.store.max_mib * 2**20 / len(self.settings.drive)
        pipeline = open_pipeline(drive, self.file.parent, self._priors.key, sound_bytes)
        unfit = self._restore(drive.name, pipeline)
        self._pipelines[drive.name] = pipeline
        self._outputs.introduce(drive.name, pipeline.meta())
        begun = "measuring" + (f"; starting anew in {', '.join(unfit)}" if unfit else "")
        self._tell_all((Event(drive.name, self.clock.time_s(), NE107.OK, "daemon", begun),))
        period_s = max(drive.block_samples / drive.rate_hz, TURN_EVERY_S)
        next_publish_s = time.monotonic()
        next_checkpoint_s = next_publish_s + CHECKPOINT_EVERY_S
        forecasting: asyncio.Task[Forecast] | None = None
        try:
            while True:
                await asyncio.sleep(period_s)
                now = self._beats[drive.name] = time.monotonic()
                due = now >= next_publish_s
                await self._turn(pipeline, due)
                self._tell_all(pipeline.recommission(self.store_file, self.clock.time_s()))
                if due:
                    next_publish_s = now + PUBLISH_EVERY_S
                    self._tell_all(pipeline.follow_model(self.clock.time_s()))
                    self._tell_all(pipeline.take_prior(self.clock.time_s(), self._priors))
                    forecast = pipeline.due_forecast()
                    if forecast:  # takes a while on a small computer: registers and watchdog do not wait for it
                        forecasting = asyncio.create_task(asyncio.to_thread(forecast))
                if forecasting and forecasting.done():
                    pipeline.accept(forecasting.result())
                    forecasting = None
                if now >= next_checkpoint_s:
                    next_checkpoint_s = now + CHECKPOINT_EVERY_S
                    self.history.save(drive.name, pipeline.state())
                    self._on_probation.discard(drive.name)
        except asyncio.CancelledError:  # an orderly end; what a failure leaves behind is not worth keeping
            self.history.save(drive.name, pipeline.state())
            self._on_probation.discard(drive.name)
            raise
        finally:
            self._pipelines.pop(drive.name, None)

    def _restore(self, drive: str, pipeline: Pipeline) -> tuple[str, ...]:
        """Take the last checkpoints over; the names of what begins anew.

        Where the last try failed before it could save one, what was learned may be what fails, and is left out; the
        account of the gear's life is kept whatever happens.
        """
        doubted = Pipeline.LEARNED if drive in self._on_probation else ()
        self._on_probation.add(drive)
        parts = [part for part in Pipeline.PARTS if part not in doubted]
        return pipeline.restore(self.history.load(drive, parts)) + doubted

    async def _turn(self, pipeline: Pipeline, due: bool) -> None:
        """Process what has arrived; `due`: tell the fleet and the store too."""
        now_s = self.clock.time_s()
        step = pipeline.step(now_s, [source.health() for source in self._sources.values()])
        self._snapshots[step.snapshot.drive] = step.snapshot
        for block in step.blocks:
            self.history.add_block(block)
        self._tell_all(step.events)
        await self._outputs.show(step.snapshot, now_s)
        if due:
            self.history.add_snapshot(step.snapshot)
            self._outputs.publish(step.snapshot)

    async def _keep(self) -> None:
        """Commit in a thread, so that a slow disk stalls nothing; a full one is said once.

        At once where something happened, and often while the run is young: a cut costs at most half of it.
        """
        began_s = time.monotonic()
        while True:
            wait_s = commit_within_s(time.monotonic() - began_s, self.settings.store.commit_every_s)
            await asyncio.sleep(LEAST_COMMIT_S)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._happened.wait(), wait_s - LEAST_COMMIT_S)
            self._happened.clear()
            problem = await asyncio.to_thread(self.history.commit)
            self._say_change("store", problem)
            self._tell_store_notes()

    def _tell_store_notes(self) -> None:
        for note in self.history.take_notes():
            self._tell(NE107.MAINTENANCE_REQUIRED, "store", note)

    async def _watch(self) -> None:
        """Feed the service manager only while every drive's loop turns; note steps of the clock."""
        back = self.clock.steps_back
        while True:
            await asyncio.sleep(1.0)
            if not self.late_drives():
                self._notifier.send(WATCHDOG=1, STATUS=self._summary())
            self.clock.time_s()
            if self.clock.steps_back > back:
                back = self.clock.steps_back
                offset_s = self.clock.wall_offset_s
                self._tell(NE107.MAINTENANCE_REQUIRED, "clock", f"set back by {-offset_s:.1f} s; data time goes on")

    def late_drives(self) -> list[str]:
        """Drives whose loop should turn and does not; one that waits for its next try is no reason to be killed."""
        waiting = {task.name for task in self._supervisor.health() if task.state != "running"}
        horizon_s = time.monotonic() - LATE_AFTER_S
        return [name for name, beat_s in self._beats.items() if beat_s < horizon_s and f"drive {name}" not in waiting]

    def _summary(self) -> str:
        worst = max((snapshot.state for snapshot in self._snapshots.values()), default=NE107.OK)
        return f"{len(self._snapshots)} drives, worst state {worst.name.lower().replace('_', ' ')}"

    # events

    def _tell(self, severity: NE107, source: str, message: str) -> None:
        self._tell_all((Event("", self.clock.time_s(), severity, source, message),))

    def _tell_all(self, events: tuple[Event, ...]) -> None:
        for event in events:
            level = logging.INFO if event.severity is NE107.OK else logging.WARNING
            log.log(level, "%s: %s", event.drive or "gateway", said(event.source, event.message))
            self._events.append(event)
            self.history.add_event(event)
            self._outputs.event(event)
            self._happened.set()

    def _say_change(self, source: str, reason: str) -> None:
        """An event when a standing trouble begins, changes or ends."""
        before = self._reasons.get(source, "")
        if reason != before:
            self._reasons[source] = reason
            severity = NE107.MAINTENANCE_REQUIRED if reason else NE107.OK
            self._tell(severity, source, reason or f"well again (was: {before})")

    # reload

    async def _follow_hangups(self) -> None:
        """One reload after the other: a hangup that comes while one runs asks for the next."""
        while True:
            await self._hangup.wait()
            self._hangup.clear()
            await self._reload()

    async def _reload(self) -> None:
        """Take a changed configuration over: only what changed is stopped and started; buffers stay."""
        try:
            settings = examined(self.file, self._i2c_bus is not None)
            opened = self._newly_opened(settings)
            paths = self._outputs.made(settings)
            priors = PriorInbox(key_of(settings.zenoh, self.file.parent))
        except BadInput as error:
            self._tell(NE107.MAINTENANCE_REQUIRED, "configuration", f"not taken over: {error}")
            return
        old, self.settings = self.settings, settings
        if old.zenoh != settings.zenoh:
            self._priors = priors
        self._notifier.send(STATUS="taking over a changed configuration")
        await self._exchange_sources(settings, opened)
        await self._exchange_drives(old, settings)
        await self._outputs.exchange(paths)
        for section in ("store", "gateway"):
            if getattr(old, section) != getattr(settings, section):
                self._tell(NE107.MAINTENANCE_REQUIRED, "configuration", f"[{section}] changes need a restart")
        self._tell(NE107.OK, "configuration", "taken over")

    def _newly_opened(self, new: Settings) -> list[Source]:
        """Sources that are new or changed, not yet started. Raises `BadInput`."""
        rows = [row for row in new.sources if row not in self.settings.sources]
        return [open_source(row, self.file.parent, self._i2c_bus) for row in rows]

    async def _exchange_sources(self, new: Settings, opened: list[Source]) -> None:
        kept = {row.name for row in new.sources} - {source.name for source in opened}
        for name in set(self._sources) - kept:
            await self._stop_source(name)
        for source in opened:
            self._start_source(source)

    async def _exchange_drives(self, old: Settings, new: Settings) -> None:
        before = {drive.name: drive for drive in old.drive}
        after = {drive.name: drive for drive in new.drive}
        for name in before:
            if before[name] != after.get(name):
                await self._stop_drive(name)
        for name, drive in after.items():
            if before.get(name) != drive:
                self._start_drive(drive)


def run(file: Path, verbose: bool = False) -> None:
    """The `run` command. Raises `BadInput` before anything is opened if the configuration is wrong."""
    begin_log(verbose)
    with contextlib.suppress(asyncio.CancelledError):
        asyncio.run(_run(file))


async def _run(file: Path) -> None:
    await Daemon(file).run()

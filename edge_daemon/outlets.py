"""All ways out, behind one door: registers for PLCs, the fleet's Zenoh, and the page with its metrics."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from edge_daemon.clock import Clock
from edge_daemon.publish.metrics import Metrics
from edge_daemon.publish.modbus_server import RegisterServer
from edge_daemon.publish.zenoh_link import History, ZenohLink
from edge_daemon.records import Event, GatewayState, LinkHealth, Snapshot
from edge_daemon.settings import Settings
from edge_daemon.show.dashboard import Dashboard
from edge_daemon.show.sight import Sight
from edge_daemon.supervisor import Supervisor

TICK_S = 0.5
"""the heartbeat in the registers moves this often, and the age of the data with it"""


class Outlets:
    """Starts, feeds and exchanges the ways out; each may fail without the others."""

    def __init__(
        self,
        settings: Settings,
        state: Callable[[], GatewayState],
        history: History,
        clock: Clock,
        sight: Sight | None = None,
    ) -> None:
        self._state = state
        self._sight = sight
        self._history = history
        self._clock = clock
        self._meta: dict[str, Mapping[str, Any]] = {}
        self._metrics = Metrics()
        self._build(settings)

    def _build(self, settings: Settings) -> None:
        self._settings = settings
        drives = [drive.name for drive in settings.drive]
        device_ids = {drive.name: drive.modbus_device_id for drive in settings.drive}
        self._registers = RegisterServer(settings.modbus_server, device_ids)
        self._zenoh = ZenohLink(settings.zenoh, settings.gateway, drives, self._history)
        self._page = Dashboard(settings.dashboard, self._state, Metrics().render, self._sight)

    def start(self, supervisor: Supervisor) -> None:
        """Begin to listen and to connect; a taken port is tried again by the supervisor."""
        self._supervisor = supervisor
        self._zenoh.start()
        if self._settings.modbus_server.enabled:
            supervisor.start("modbus server", self._serve_registers)
        if self._settings.dashboard.enabled:
            supervisor.start("dashboard", self._serve_page)

    async def _serve_registers(self) -> None:
        server = self._registers
        await server.start(self._clock.time_s())
        try:
            while True:
                await asyncio.sleep(TICK_S)
                await server.tick(self._clock.time_s())
        finally:
            await server.stop()

    async def _serve_page(self) -> None:
        page = self._page
        await page.start()
        try:
            await asyncio.Event().wait()
        finally:
            await page.stop()

    def introduce(self, drive: str, document: Mapping[str, Any]) -> None:
        """Publish a drive's birth document; kept for when the fleet link is exchanged."""
        self._meta[drive] = document
        self._zenoh.meta(drive, document)

    async def show(self, snapshot: Snapshot, now_s: float) -> None:
        """To the registers: every turn."""
        await self._registers.publish(snapshot, now_s)

    def publish(self, snapshot: Snapshot) -> None:
        """To the fleet."""
        self._zenoh.publish(snapshot)

    def event(self, event: Event) -> None:
        """To the fleet."""
        self._zenoh.event(event)

    def health(self) -> tuple[LinkHealth, ...]:
        """One row a way out."""
        return (self._registers.health(), self._zenoh.health())

    async def exchange(self, settings: Settings) -> None:
        """Take changed settings over; what did not change goes on undisturbed."""
        old, self_before = self._settings, (self._registers, self._zenoh, self._page)
        self._build(settings)
        same_drives = _identities(old) == _identities(settings)
        if same_drives and old.modbus_server == settings.modbus_server:
            self._registers = self_before[0]
        else:
            await self._replace("modbus server", settings.modbus_server.enabled, self._serve_registers)
        if old.dashboard == settings.dashboard:
            self._page = self_before[2]
        else:
            await self._replace("dashboard", settings.dashboard.enabled, self._serve_page)
        if same_drives and old.zenoh == settings.zenoh and old.gateway == settings.gateway:
            self._zenoh = self_before[1]
        else:
            await asyncio.to_thread(self_before[1].stop, old.zenoh.close_within_s)
            self._zenoh.start()
            for drive in settings.drive:
                if drive.name in self._meta:
                    self._zenoh.meta(drive.name, self._meta[drive.name])

    async def _replace(self, name: str, enabled: bool, run: Callable[[], Any]) -> None:
        await self._supervisor.stop(name)
        if enabled:
            self._supervisor.start(name, run)

    def close(self) -> bool:
        """Send what is queued to the fleet; whether that was done in time. May block as long as the settings say."""
        return self._zenoh.stop(self._settings.zenoh.close_within_s)


def _identities(settings: Settings) -> dict[str, int]:
    return {drive.name: drive.modbus_device_id for drive in settings.drive}

"""All ways out, behind one door: registers for PLCs, the fleet's Zenoh, and the page with its metrics."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_daemon.clock import Clock
from edge_daemon.config.settings import Settings
from edge_daemon.fleet.signed import PRIORS
from edge_daemon.publish.metrics import Metrics
from edge_daemon.publish.modbus_server import RegisterServer
from edge_daemon.publish.zenoh_link import HistoryQuery, Keep, ZenohLink
from edge_daemon.records import Event, GatewayState, LinkHealth, Snapshot
from edge_daemon.service.supervisor import Supervisor
from edge_daemon.show.dashboard import DashboardServer
from edge_daemon.show.page_api import PageApi

TICK_S = 0.5
"""The heartbeat in the registers moves this often, and the age of the data with it."""


@dataclass(frozen=True, slots=True)
class OutputPaths:
    """The ways out that one configuration asks for."""

    settings: Settings
    registers: RegisterServer
    zenoh: ZenohLink
    page: DashboardServer


class Outputs:
    """Starts, feeds and exchanges the ways out; each may fail without the others."""

    def __init__(
        self,
        settings: Settings,
        state: Callable[[], GatewayState],
        history: HistoryQuery,
        clock: Clock,
        page_api: PageApi | None = None,
        keep: Keep = lambda messages: None,
        on_prior: Callable[[bytes], None] = lambda envelope: None,
    ) -> None:
        """`on_prior` hears in Zenoh's thread what somebody offers as a prior. Raises `BadInput` as `made` does."""
        self._state = state
        self._page_api = page_api
        self._history = history
        self._keep = keep
        self._on_prior = on_prior
        self._clock = clock
        self._meta: dict[str, Mapping[str, Any]] = {}
        self._paths = self.made(settings)

    def made(self, settings: Settings) -> OutputPaths:
        """The ways out for these settings, not yet started. Raises `BadInput` for a file that is of no use."""
        return OutputPaths(
            settings,
            RegisterServer(settings.modbus_server, _device_ids(settings)),
            ZenohLink(
                settings.zenoh,
                settings.gateway,
                [drive.name for drive in settings.drive],
                self._history,
                base=self._page_api.folder if self._page_api else Path(),
                keep=self._keep,
                wanted=(f"{PRIORS}/*", self._on_prior) if settings.zenoh.prior_key_file else None,
            ),
            DashboardServer(settings.dashboard, self._state, Metrics().render, self._page_api),
        )

    def start(self, supervisor: Supervisor) -> None:
        """Begin to listen and to connect; a taken port is tried again by the supervisor."""
        self._supervisor = supervisor
        self._paths.zenoh.start()
        if self._paths.settings.modbus_server.enabled:
            supervisor.start("modbus server", self._serve_registers)
        if self._paths.settings.dashboard.enabled:
            supervisor.start("dashboard", self._serve_page)

    async def _serve_registers(self) -> None:
        server = self._paths.registers
        await server.start(self._clock.time_s())
        try:
            while True:
                await asyncio.sleep(TICK_S)
                await server.tick(self._clock.time_s())
        finally:
            await server.stop()

    async def _serve_page(self) -> None:
        page = self._paths.page
        await page.start()
        try:
            await asyncio.Event().wait()
        finally:
            await page.stop()

    def introduce(self, drive: str, document: Mapping[str, Any]) -> None:
        """Publish a drive's birth document; kept for when the fleet link is exchanged."""
        self._meta[drive] = document
        self._paths.zenoh.meta(drive, document)

    async def show(self, snapshot: Snapshot, now_s: float) -> None:
        """To the registers: every turn."""
        await self._paths.registers.publish(snapshot, now_s)

    def publish(self, snapshot: Snapshot) -> None:
        """To the fleet."""
        self._paths.zenoh.publish(snapshot)

    def event(self, event: Event) -> None:
        """To the fleet."""
        self._paths.zenoh.event(event)

    def health(self) -> tuple[LinkHealth, ...]:
        """One row a way out."""
        registers = self._paths.registers.health()
        if not self._paths.settings.modbus_server.enabled:
            registers = LinkHealth(registers.link, "off", "", registers.figures)
        return (registers, self._paths.zenoh.health())

    async def exchange(self, new: OutputPaths) -> None:
        """Take what `made` gave over; what did not change goes on undisturbed."""
        old, before, after = self._paths, self._paths.settings, new.settings
        same_drives = _device_ids(before) == _device_ids(after)
        same_registers = same_drives and before.modbus_server == after.modbus_server
        same_page = before.dashboard == after.dashboard
        same_zenoh = same_drives and before.zenoh == after.zenoh and before.gateway == after.gateway
        self._paths = OutputPaths(
            after,
            old.registers if same_registers else new.registers,
            old.zenoh if same_zenoh else new.zenoh,
            old.page if same_page else new.page,
        )
        if not same_registers:
            await self._replace("modbus server", after.modbus_server.enabled, self._serve_registers)
        if not same_page:
            await self._replace("dashboard", after.dashboard.enabled, self._serve_page)
        if not same_zenoh:
            await asyncio.to_thread(old.zenoh.stop, before.zenoh.close_within_s)
            new.zenoh.start()
            for drive in after.drive:
                if drive.name in self._meta:
                    new.zenoh.meta(drive.name, self._meta[drive.name])

    async def _replace(self, name: str, enabled: bool, run: Callable[[], Any]) -> None:
        await self._supervisor.stop(name)
        if enabled:
            self._supervisor.start(name, run)

    def close(self) -> bool:
        """Send what is queued to the fleet; whether that was done in time. May block as long as the settings say."""
        return self._paths.zenoh.stop(self._paths.settings.zenoh.close_within_s)


def _device_ids(settings: Settings) -> dict[str, int]:
    return {drive.name: drive.modbus_device_id for drive in settings.drive}

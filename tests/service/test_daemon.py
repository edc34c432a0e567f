"""The whole daemon in a hostile world: buses drop, sensors lie, disks fill, clocks step; it says so and goes on."""

from __future__ import annotations

import asyncio
import math
import os
import shutil
import signal
import sqlite3
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from edge_daemon.clock import Clock
from edge_daemon.demo.gateway import prepare
from edge_daemon.errors import BadInput
from edge_daemon.integrator import machine_code
from edge_daemon.records import NE107, GatewayState
from edge_daemon.rig.child import RigProcess
from edge_daemon.rig.i2c_face import open_bus
from edge_daemon.service.daemon import Daemon
from edge_daemon.service.pipeline import Pipeline
from edge_daemon.store.reader import StoreReader

ROOT = Path(__file__).parents[2]
DEADLINE_S = 20.0


class Bench:
    """A daemon under test, its simulated drive, and waiting with a limit."""

    def __init__(self, file: Path, rig: RigProcess, clock: Clock) -> None:
        self.file, self.rig = file, rig
        self.daemon = Daemon(file, i2c_bus=lambda name: open_bus(str(name)), clock=clock)

    @property
    def state(self) -> GatewayState:
        return self.daemon.state()

    def source(self, name: str) -> str:
        return next(source.state for source in self.state.sources if source.source == name)

    def drive_state(self) -> NE107:
        found = self.state.snapshots.get("axis-1")
        return found.state if found else NE107.FUNCTION_CHECK

    def reasons(self) -> str:
        found = self.state.snapshots.get("axis-1")
        return " ".join(found.reasons) if found else ""

    def model_error(self) -> Mapping[str, Any]:
        return self.state.snapshots["axis-1"].details["model_error"]

    def messages(self) -> str:
        return "\n".join(f"{event.source}: {event.message}" for event in self.state.events)

    def data_age_s(self) -> float:
        found = self.state.snapshots.get("axis-1")
        return self.state.now_s - found.time_s if found and math.isfinite(found.time_s) else math.inf

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end:
                raise AssertionError(f"{what}: not within {DEADLINE_S:.0f} s; {self.reasons()}; {self.messages()}")
            await asyncio.sleep(0.02)

    async def measuring(self) -> None:
        await self.until(lambda: self.data_age_s() < 1.0, "fresh data")

    def change(self, **sections: dict[str, object]) -> None:
        """Edit the configuration file."""
        document = tomlkit.parse(self.file.read_text())
        for name, keys in sections.items():
            document.setdefault(name, {}).update(keys)
        self.file.write_text(tomlkit.dumps(document))


@asynccontextmanager
async def bench(
    folder: Path, clock: Clock | None = None, before: Callable[[Path], None] | None = None
) -> AsyncIterator[Bench]:
    with RigProcess() as rig:
        file = prepare(folder, rig.ready, 1, free_ports=True)
        if before:
            before(file)
        it = Bench(file, rig, clock or Clock())
        task = asyncio.create_task(it.daemon.run())
        try:
            yield it
        finally:
            it.daemon.stop()
            await asyncio.wait_for(task, DEADLINE_S)


@pytest.mark.slow
async def test_a_bus_that_drops_is_said_and_taken_up_again(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        it.rig.order(can="down")
        await it.until(lambda: it.source("can0") == "down", "bus down")
        await it.until(lambda: "can0" in it.reasons(), "the state names the bus")
        assert it.drive_state() is not NE107.OK
        it.rig.order(can="up")
        await it.until(lambda: it.source("can0") == "ok" and it.data_age_s() < 1.0, "bus up")
        await it.until(lambda: "can0" not in it.reasons(), "the state clears")


@pytest.mark.parametrize("fault", ["frozen", "offset", "reset"])
async def test_a_lying_encoder_is_told_and_the_daemon_goes_on(tmp_path: Path, fault: str) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        if fault == "reset":  # near zero it would change nothing: away from there first
            it.rig.order(drive=1, fault="offset", size=1.5)
            await it.until(lambda: "(1 times so far)" in it.messages(), "away from zero")
            it.rig.order(drive=1, fault="reset")
            await it.until(lambda: "(2 times so far)" in it.messages(), "an event about the reset itself")
            return
        it.rig.order(drive=1, fault=fault, **({"size": 1.5} if fault == "offset" else {}))
        await it.until(lambda: "theta_out_rad" in it.messages(), f"an event about the {fault}")
        if fault == "frozen":
            it.rig.order(drive=1, repair=fault)
        await it.until(lambda: it.data_age_s() < 1.0, "fresh data")
        assert all(task.state == "running" for task in it.state.tasks), it.state.tasks


@pytest.mark.slow
async def test_sensors_that_fail_beside_the_encoders_stop_nothing(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        it.rig.order(drive=1, i2c="absent", modbus="silent")
        await it.until(lambda: it.source("housing1") != "ok" and it.source("air1") != "ok", "both are told")
        before = it.state.snapshots["axis-1"].sequence
        await it.until(lambda: it.state.snapshots["axis-1"].sequence > before + 5, "blocks go on")
        it.rig.order(drive=1, i2c="none", modbus="none")
        await it.until(lambda: it.source("housing1") == "ok" and it.source("air1") == "ok", "both recover")


async def test_garbage_on_the_line_is_counted_and_survived(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        for text in (b"t18", b"tZZZ8xxxxxxxxxxxxxxxx\r", b"\xff\xfe\r\r", b"t1812ABCD\r", b"t7FF80011223344556677\r"):
            it.rig.order(can="raw", hex=text.hex())
        before = it.state.snapshots["axis-1"].sequence
        await it.until(lambda: it.state.snapshots["axis-1"].sequence > before + 5, "blocks go on")
        assert "can0" not in [task.name for task in it.state.tasks if task.state == "waiting"]


async def test_a_clock_set_back_does_not_turn_data_time_back(tmp_path: Path) -> None:
    step = 0.0
    clock = Clock(wall=lambda: time.time() + step)
    async with bench(tmp_path, clock) as it:
        await it.measuring()
        before_s = it.state.snapshots["axis-1"].time_s
        step = -3600.0
        await it.until(lambda: "set back by 3600" in it.messages(), "the step is told")
        await it.until(lambda: it.state.snapshots["axis-1"].time_s > before_s + 0.5, "data time goes on")
    with StoreReader(tmp_path / "demo.sqlite") as reader:
        starts = [block.start_s for block in reader.blocks("axis-1")]
    assert starts == sorted(starts) and len(set(starts)) == len(starts)


async def test_a_full_disk_costs_nothing_that_was_stored(tmp_path: Path) -> None:
    """`commit` meets a full disk: SQLite is told that the file may not grow further."""
    async with bench(tmp_path) as it:
        await it.measuring()
        store = it.daemon.history.store
        await it.until(lambda: _blocks_stored(tmp_path) > 5, "blocks in the store")
        stored = _blocks_stored(tmp_path)
        pages = store.database.execute("pragma page_count").fetchone()[0]
        store.database.execute(f"pragma max_page_count = {pages}")
        await it.until(lambda: "store" in it.messages(), "a full disk is told")
        assert all(task.state == "running" for task in it.state.tasks)
        assert _blocks_stored(tmp_path) >= stored
        store.database.execute("pragma max_page_count = 1000000")
        await it.until(lambda: "well again" in it.messages(), "and that there is room again")
        await it.until(lambda: _blocks_stored(tmp_path) > stored + 5, "blocks are stored again")
    with sqlite3.connect(tmp_path / "demo.sqlite") as connection:
        assert connection.execute("pragma integrity_check").fetchone() == ("ok",)


def _blocks_stored(folder: Path) -> int:
    with StoreReader(folder / "demo.sqlite") as reader:
        return sum(1 for _ in reader.blocks("axis-1"))


async def test_a_router_that_is_absent_is_said_and_holds_nothing_up(tmp_path: Path) -> None:
    def towards_nobody(file: Path) -> None:
        document = tomlkit.parse(file.read_text())
        document["zenoh"] = {"mode": "client", "connect": ["tcp/127.0.0.1:9"], "listen": []}
        file.write_text(tomlkit.dumps(document))

    async with bench(tmp_path, before=towards_nobody) as it:
        await it.measuring()
        await it.until(lambda: any(link.link == "zenoh" and link.state == "down" for link in it.state.links), "down")
        assert next(link for link in it.state.links if link.link == "zenoh").reason


async def test_hangup_takes_a_changed_configuration_over_and_keeps_what_was_buffered(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        await it.until(lambda: _blocks_stored(tmp_path) > 5, "blocks in the store")
        stored = _blocks_stored(tmp_path)
        text = it.file.read_text().replace("max_rate = 5.0", "max_rate = 6.0")
        it.file.write_text(text)
        os.kill(os.getpid(), signal.SIGHUP)
        await it.until(lambda: "taken over" in it.messages(), "the change is taken over")
        await it.measuring()
        assert it.daemon.settings.drive[0].channels[1].max_rate == 6.0
        it.file.write_text(text.replace("max_rate = 6.0", "max_rote = 6.0"))
        os.kill(os.getpid(), signal.SIGHUP)
        await it.until(lambda: "max_rote" in it.messages(), "a mistake is refused")
        await it.measuring()
        await it.until(lambda: _blocks_stored(tmp_path) > stored + 5, "blocks go on")


async def test_hangup_never_gives_up_a_good_configuration_for_one_that_cannot_run(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        good = it.file.read_text()
        for change, complaint in (
            (("drive.dbc", "gone.dbc"), "gone.dbc"),
            (('"axis.model.toml"', '"gone.model.toml"'), "gone.model.toml"),
            (("EncoderOut1.Position", "EncoderOut9.Position"), "EncoderOut9.Position"),
            (("[dashboard]", '[dashboard]\ntoken_file = "gone.token"'), "gone.token"),
            (("sim:", "/dev/"), "expected a number"),
        ):
            before = it.state.snapshots["axis-1"].sequence
            it.file.write_text(good.replace(*change))
            os.kill(os.getpid(), signal.SIGHUP)
            await it.until(lambda: complaint in it.messages(), f"{complaint} is refused")  # noqa: B023
            await it.until(lambda: it.state.snapshots["axis-1"].sequence > before + 2, "the same pipeline goes on")  # noqa: B023
        assert it.messages().count("not taken over") == 5
        assert all(task.restarts == 0 for task in it.state.tasks)


async def test_a_drive_that_cannot_work_is_told_and_takes_nobody_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One drive waits for its next try: its last good state must not stand, and the watchdog must be fed."""

    def broken(*_: object) -> None:
        raise RuntimeError("out of order")

    monkeypatch.setattr("edge_daemon.service.daemon.open_pipeline", broken)
    async with bench(tmp_path) as it:
        await it.until(lambda: it.drive_state() is NE107.FAILURE, "the drive has failed")
        assert "out of order" in it.reasons()
        await it.until(lambda: any(task.state == "waiting" for task in it.state.tasks), "it waits for its next try")
        monkeypatch.setattr("edge_daemon.service.daemon.LATE_AFTER_S", -1.0)
        assert it.daemon.late_drives() == []


async def test_a_changed_model_file_is_taken_over_and_a_broken_one_is_not(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        model = tmp_path / "axis.model.toml"
        good = model.read_text()
        model.write_text(good + '\n[[effect]]\nname = "coulomb_friction"\n')
        await it.until(lambda: "coulomb_friction" in it.messages(), "the effect is taken over")
        await it.until(lambda: "coulomb_friction" in it.model_error()["effects"], "and its error is published")
        assert it.model_error()["before"]["effects"] == ["linear_stiffness", "viscous_damping", "kinematic_error"]
        model.write_text(good + '\n[[effect]]\nname = "coulomb_fiction"\n')
        await it.until(lambda: "not taken over" in it.messages(), "the typo is refused")
        await it.measuring()


async def test_a_stopped_daemon_leaves_everything_stored_and_starts_where_it_was(tmp_path: Path) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
        await it.until(lambda: it.state.snapshots["axis-1"].sequence > 20, "two seconds of blocks")
        newest_s = it.state.snapshots["axis-1"].time_s
    with StoreReader(tmp_path / "demo.sqlite") as reader:
        assert reader.newest_s() >= newest_s - 0.2
        assert reader.drives() == ("axis-1",)
    async with bench(tmp_path) as it:
        await it.measuring()
        assert "starting anew" not in it.messages()


async def test_a_checkpoint_that_makes_a_drive_fail_is_not_taken_up_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with bench(tmp_path) as it:
        await it.measuring()
    restored: list[set[str]] = []
    restore, step = Pipeline.restore, Pipeline.step

    def watched(self: Pipeline, parts: Mapping[str, bytes]) -> tuple[str, ...]:
        restored.append(set(parts))
        return restore(self, parts)

    def poisoned(self: Pipeline, *arguments: Any) -> Any:
        if "estimates" in restored[-1]:
            raise RuntimeError("poisoned")
        return step(self, *arguments)

    monkeypatch.setattr(Pipeline, "restore", watched)
    monkeypatch.setattr(Pipeline, "step", poisoned)
    async with bench(tmp_path) as it:
        await it.measuring()
        assert "starting anew in estimates" in it.messages()
    assert "estimates" in restored[0] and restored[1] >= {"life", "trends", "alarms"}


def test_a_wrong_configuration_opens_nothing(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text('[gateway]\nname = "x"\n')
    with pytest.raises(BadInput, match="expected at least one"):
        Daemon(file)
    shutil.copy(ROOT / "config" / "demo.toml", file)
    with pytest.raises(BadInput, match=r"drive\.dbc"):
        Daemon(file)
    assert list(tmp_path.iterdir()) == [file]


async def test_a_daemon_that_stops_while_it_compiles_leaves_no_wait_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another drive of this process would wait for ever for machine code that nobody makes."""
    monkeypatch.setattr(machine_code, "library", lambda: tmp_path / "never.so")
    async with bench(tmp_path) as it:
        await it.until(lambda: not machine_code.is_ready(), "the child compiles")
    assert machine_code.is_ready()


async def test_a_daemon_that_stops_while_it_loads_leaves_no_wait_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loading, enough = threading.Event(), threading.Event()

    def slow() -> None:
        loading.set()
        enough.wait(DEADLINE_S)

    async def compiled(_: Daemon) -> bool:
        return True

    monkeypatch.setattr(machine_code, "library", lambda: tmp_path / "never.so")
    monkeypatch.setattr(machine_code, "load", slow)
    monkeypatch.setattr(Daemon, "compile_in_a_child", compiled)
    async with bench(tmp_path) as it:
        await it.until(loading.is_set, "the machine code is loaded")
        it.daemon.stop()
        await it.until(machine_code.is_ready, "the wait ends with the daemon")
        enough.set()

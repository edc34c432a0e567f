"""The supervisor, on a loop whose sleeps cost nothing."""

from __future__ import annotations

import asyncio

from edge_daemon.service.supervisor import LONGEST_WAIT_S, Supervisor


class FreeSleep:
    """Remembers how long each wait would have been, and only yields."""

    def __init__(self) -> None:
        self.waits: list[float] = []

    async def __call__(self, seconds: float) -> None:
        self.waits.append(seconds)
        await asyncio.sleep(0)


async def test_a_failing_task_is_restarted_with_a_wait_that_doubles_up_to_its_limit() -> None:
    sleep, done, runs = FreeSleep(), asyncio.Event(), 0

    async def fails_nine_times() -> None:
        nonlocal runs
        runs += 1
        if runs <= 9:
            raise OSError("no such bus")
        done.set()

    supervisor = Supervisor(sleep)
    supervisor.start("bus", fails_nine_times)
    async with asyncio.timeout(5):
        await done.wait()
        while supervisor.health()[0].state != "finished":  # noqa: ASYNC110
            await asyncio.sleep(0)
    assert sleep.waits == [0.5, 1, 2, 4, 8, 16, LONGEST_WAIT_S, LONGEST_WAIT_S, LONGEST_WAIT_S]
    health = supervisor.health()[0]
    assert (health.restarts, health.reason) == (9, "no such bus")


async def test_one_failing_task_leaves_the_others_running() -> None:
    sleep, ticks = FreeSleep(), 0

    async def fails() -> None:
        raise ValueError("broken")

    async def ticks_on() -> None:
        nonlocal ticks
        while True:
            ticks += 1
            await asyncio.sleep(0)

    supervisor = Supervisor(sleep)
    supervisor.start("bad", fails)
    supervisor.start("good", ticks_on)
    async with asyncio.timeout(5):
        while ticks < 50:  # noqa: ASYNC110
            await asyncio.sleep(0)
    states = {task.name: task.state for task in supervisor.health()}
    assert states["good"] == "running"
    assert await supervisor.stop_all(1.0) == ()


async def test_a_task_that_ignores_its_end_is_named_and_does_not_hold_the_shutdown() -> None:
    stubborn_began, release = asyncio.Event(), asyncio.Event()

    async def stubborn() -> None:
        stubborn_began.set()
        while not release.is_set():
            try:
                await release.wait()
            except asyncio.CancelledError:
                continue

    supervisor = Supervisor()
    supervisor.start("stubborn", stubborn)
    await stubborn_began.wait()
    assert await supervisor.stop_all(0.05) == ("stubborn",)
    release.set()


async def test_a_task_that_fails_while_it_ends_is_not_started_again() -> None:
    begun = asyncio.Event()

    async def clumsy() -> None:
        begun.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError as error:
            raise RuntimeError("the line was lost just now") from error

    supervisor = Supervisor()
    supervisor.start("clumsy", clumsy)
    await begun.wait()
    assert await supervisor.stop_all(10.0) == ()


async def test_a_task_whose_group_failed_is_started_again() -> None:
    """A TaskGroup of Python 3.11 and 3.12 leaves its parent marked as cancelled: nobody told that task to end."""
    runs = 0

    async def lost() -> None:
        raise OSError("the connection is closed")

    async def polls_in_a_group() -> None:
        nonlocal runs
        runs += 1
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(lost())
        except* OSError:
            pass
        raise OSError("lost")

    supervisor = Supervisor(FreeSleep())
    supervisor.start("line", polls_in_a_group)
    async with asyncio.timeout(5):
        while runs < 4:  # noqa: ASYNC110
            await asyncio.sleep(0)
    assert runs == 4
    await supervisor.stop("line")

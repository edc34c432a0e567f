"""`demo` as a story: one drive is well, one hides an effect, one wears out; what is missing is found and added."""

from __future__ import annotations

import asyncio
import os
import shlex
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from edge_daemon.commands.check import export
from edge_daemon.demo.terminal_plot import curve
from edge_daemon.records import Estimate, GatewayState
from edge_daemon.rig.child import RigProcess
from edge_daemon.service.daemon import Daemon
from edge_daemon.text import indented, number, painted, progress, table, with_sd

HEALTHY, HIDDEN, FAILING = "axis-1", "axis-2", "axis-3"
EFFECTS = ("1:kinematic_error", "2:kinematic_error", "2:coulomb_friction", "3:kinematic_error")
"""The model of each knows the kinematic error, and that of the second lacks its friction."""
WEAR, WEAR_PER_S = 0.55, 0.001
"""After its commissioning the third gear loses a sixth of its stiffness at once, and some more each minute."""
BASELINE_AFTER_S = 20.0
RECORD_S = 20.0
"""So much motion is compared; a diagnosis of more takes longer and says the same."""
KNOWN_WITHIN_S, FALLEN_WITHIN_S, FAILS_WITHIN_S = 60.0, 90.0, 150.0
"""A slow computer takes so long; then the story goes on without."""
FALLEN = 0.3
"""The live error has fallen when it is this share of what it was."""
LOOK_S = 0.5


@dataclass(slots=True)
class Storyteller:
    """What is seen of the daemon while the story runs."""

    daemon: Daemon
    rig: RigProcess
    folder: Path
    begun_s: float = field(default_factory=time.monotonic)
    errors: list[tuple[float, float]] = field(default_factory=list)
    """(seconds since the begin, model error of the hidden drive [%])"""
    added_s: float = 0.0

    @property
    def age_s(self) -> float:
        """Since the begin."""
        return time.monotonic() - self.begun_s

    def value(self, drive: str, name: str) -> Estimate | None:
        """A usable estimate, or none."""
        snapshot = self.daemon.state().snapshots.get(drive)
        found = snapshot.estimates.get(name) if snapshot else None
        return found if found and found.usable else None

    async def watch(self) -> None:
        """Keeps the hidden drive's error, and lets the third gear wear once it is commissioned. Until cancelled."""
        worn = False
        while True:
            error = self.value(HIDDEN, "model_nrmse")
            if error:
                self.errors.append((self.age_s, 100.0 * error.value))
            if not worn and self.value(FAILING, "stiffness_change"):
                worn = True
                await asyncio.to_thread(self.rig.order, drive=3, wear=WEAR, wear_per_s=WEAR_PER_S)
            await asyncio.sleep(LOOK_S)

    async def until(self, words: str, ready: Callable[[], bool], within_s: float) -> bool:
        """Whether it came true in time; how long that may take is shown."""
        say, begun_s = progress(words), time.monotonic()
        while not ready() and time.monotonic() - begun_s < within_s:
            say("at most", (time.monotonic() - begun_s) / within_s)
            await asyncio.sleep(LOOK_S)
        say("done", 1.0)
        return ready()


async def tell(daemon: Daemon, rig: RigProcess, folder: Path) -> None:
    """The story, printed; it leaves the page as a person may go on with it."""
    seen = Storyteller(daemon, rig, folder)
    watching = asyncio.create_task(seen.watch())
    try:
        for part in (_at_first, _what_is_missing, _how_the_error_fell, _the_third):
            await part(seen)
    finally:
        watching.cancel()
    if seen.added_s:
        await asyncio.to_thread(_run, seen, "undo", "--model", f"{HIDDEN}.model.toml")
    print(_what_to_click(daemon), flush=True)


async def _at_first(seen: Storyteller) -> None:
    _head("Three simulated drives, read through the drivers of real hardware")
    known = [(HEALTHY, "model_nrmse"), (HIDDEN, "model_nrmse"), (FAILING, "model_nrmse")]
    ready = lambda: all(seen.value(*one) for one in known) and seen.age_s > RECORD_S + 2.0  # noqa: E731
    await seen.until("learning", ready, KNOWN_WITHIN_S)
    print(overview(seen.daemon.state()))


def overview(state: GatewayState) -> str:
    """A line per drive."""
    rows = []
    for name, snapshot in state.snapshots.items():
        row = snapshot.estimates
        error, floor = (100.0 * row[key].value if key in row else float("nan") for key in
                        ("model_nrmse", "model_noise_floor"))  # fmt: skip
        k = row.get("stiffness")
        stiffness = with_sd(k.value, k.sd) if k and k.usable else "-"
        word = snapshot.state.name.lower().replace("_", " ")
        rows.append((name, word, stiffness, f"{number(error, 2)} %", f"{number(floor, 2)} %"))
    return table(("drive", "state", "stiffness [N m/rad]", "model misses", "noise alone"), rows)


async def _what_is_missing(seen: Storyteller) -> None:
    _head(f"{HIDDEN} works, yet its model misses far more than noise: what does it lack?")
    store, recording, since = seen.daemon.store_file, seen.folder / f"{HIDDEN}.parquet", f"{RECORD_S:.0f}s"
    print(_typed("export", "--store", store.name, "--drive", HIDDEN, "--since", since, "--out", recording.name))
    print(await asyncio.to_thread(export, store, recording, since, HIDDEN))
    model = ("--model", f"{HIDDEN}.model.toml")
    await asyncio.to_thread(_run, seen, "compare", recording.name, *model)
    found = await asyncio.to_thread(_run, seen, "diagnose", recording.name, *model)
    effect = next((line.split()[3] for line in found.splitlines() if line.startswith("next: edge-daemon add")), "")
    if not effect:
        return
    _head(f"{effect.replace('_', ' ').replace('+', ' and ')}: added, and the daemon takes the model over")
    await asyncio.to_thread(_run, seen, "add", effect, *model, "--recording", recording.name)
    seen.added_s = seen.age_s


async def _how_the_error_fell(seen: Storyteller) -> None:
    if not seen.added_s:
        return
    before = seen.errors[-1][1] if seen.errors else float("inf")
    fallen = lambda: seen.errors[-1][1] < FALLEN * before if seen.errors else False  # noqa: E731
    await seen.until("the live error falls", fallen, FALLEN_WITHIN_S)
    x, y = zip(*seen.errors, strict=True)
    print(curve(x, y, f"{HIDDEN}: live model error [%], on a logarithmic axis", [(seen.added_s, "added")], log=True))
    print(painted(f"{before:.3g} % -> {y[-1]:.3g} %", "good"))


async def _the_third(seen: Storyteller) -> None:
    _head(f"Meanwhile {FAILING} wears out")
    bad = lambda: "stiffness" in " ".join(seen.daemon.state().snapshots[FAILING].reasons)  # noqa: E731
    await seen.until("an alarm of slow causes waits a minute", bad, FAILS_WITHIN_S)
    snapshot = seen.daemon.state().snapshots[FAILING]
    word = snapshot.state.name.lower().replace("_", " ")
    print(painted(f"{FAILING}: {word}", "warn" if snapshot.state else "good"))
    for reason in snapshot.reasons:
        print(indented(reason))


def _what_to_click(daemon: Daemon) -> str:
    page = daemon.settings.dashboard
    root = f"{page.scheme}://{page.host}:{page.port}/"
    return (
        f"\n{painted('Now you.', 'strong')} {HIDDEN} has the model that it had at first. Open\n\n"
        f"    {painted(f'{root}#/drive/{HIDDEN}', 'strong')}\n\n"
        "  1. click Find what is missing\n"
        "  2. click Add beside the first line, and watch the error fall\n"
        f"{FAILING} says at {root}#/drive/{FAILING} what is wrong, why and what to do.\n"
        f"Files: {daemon.file.parent}. Stop with Ctrl-C."
    )


def _head(text: str) -> None:
    print(f"\n{painted(text, 'strong')}\n", flush=True)


def _typed(*words: str) -> str:
    return painted(f"$ edge-daemon {shlex.join(words)}", "quiet")


def _kindly() -> None:
    """The daemon and the drives go before what is computed beside them."""
    os.nice(10)


def _run(seen: Storyteller, *words: str) -> str:
    """Runs one command in the demonstration's folder as a person would, and prints what it says but parameters."""
    import subprocess

    print(_typed(*words), flush=True)
    command = [sys.executable, "-m", "edge_daemon", *words]
    done = subprocess.run(command, cwd=seen.folder, capture_output=True, text=True, check=False, preexec_fn=_kindly)  # noqa: S603
    said = done.stdout if done.returncode in (0, 1) else done.stdout + done.stderr
    print(said.partition("\neffect  ")[0].rstrip(), "\n", flush=True)
    return done.stdout

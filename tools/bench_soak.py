"""Hours of a drive at work, in simulated time through the chain that the daemon runs, store included: what grows?

    SOAK_HOURS=24 .venv/bin/python tools/bench.py soak

Without the variable it is a tenth of an hour, which tells only that the bench works. A line an hour goes to the error
output; growth is told from the hour's third on, when what is loaded late is loaded and every buffer is full.
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import Row  # noqa: E402

from edge_daemon.config.settings import StoreSettings  # noqa: E402
from edge_daemon.records import Array  # noqa: E402
from edge_daemon.rig.live import live_drive  # noqa: E402
from edge_daemon.rig.motion import MotorCourse  # noqa: E402
from edge_daemon.rig.plant import Plant  # noqa: E402
from edge_daemon.service.history import History  # noqa: E402
from edge_daemon.service.pipeline import open_pipeline  # noqa: E402
from tests.service.scenario import COMPLETE, SEED, START_S, Scene, drive_settings, model_text  # noqa: E402

HOURS = float(os.environ.get("SOAK_HOURS", "0.1"))
STEP_S = 0.3
WARM_SHARE = 1 / 3
COMMIT_EVERY_S, SAVE_EVERY_S = 1.0, 60.0
STORE_MIB = 256
"""The ring is full within the soak's first third, so that its size says something [MiB]."""
GROWTH_LIMIT_MIB = 8.0
"""What resident memory may gain from a third of the soak to its end: the noise of the allocator [MiB]."""


@dataclass(frozen=True, slots=True)
class Held:
    """What the process holds at one instant."""

    memory_mib: float
    descriptors: int
    threads: int
    objects: int
    file_mib: float


class FastPlant(Plant):
    """A plant in machine code: what is asked for is hours."""

    def run(
        self, time_s: Array, motor: MotorCourse, temperature_degC: Array, *, compiled: bool = True
    ) -> tuple[Array, Array]:
        return super().run(time_s, motor, temperature_degC, compiled=compiled)


def _held(file: Path) -> Held:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    beside = sum(path.stat().st_size for path in file.parent.glob(f"{file.name}*"))
    return Held(
        pages * os.sysconf("SC_PAGE_SIZE") / 2**20,
        len([*Path("/proc/self/fd").iterdir()]),
        threading.active_count(),
        len(gc.get_objects()),
        beside / 2**20,
    )


def _soak(folder: Path) -> Iterator[Held]:
    """What is held twelve times, evenly over the soak."""
    (folder / "axis.model.toml").write_text(model_text(COMPLETE))
    drive = live_drive(SEED)
    drive.plant = FastPlant(drive.plant.joint, drive.plant.influences, step_s=drive.plant.step_s)
    it = Scene(folder, drive, open_pipeline(drive_settings(), folder))
    history = History(StoreSettings(file="soak.sqlite", max_mib=STORE_MIB), folder)
    steps, parts = round(HOURS * 3600 / STEP_S), 12
    for step in range(1, steps + 1):
        end_s = step * STEP_S
        first = round(it.drive.time_s * 1000)
        for record in it.records(it.drive.advance(end_s), first):
            it.pipeline.push(record)
        done = it.pipeline.step(START_S + end_s, ())
        for block in done.blocks:
            history.add_block(block)
        for event in done.events:
            history.add_event(event)
        history.add_snapshot(done.snapshot)
        if step % round(SAVE_EVERY_S / STEP_S) == 0:
            history.save("axis", it.pipeline.state())
        if step % round(COMMIT_EVERY_S / STEP_S) == 0:
            history.commit()
        if step * parts // steps > (step - 1) * parts // steps:
            held = _held(history.file)
            print(f"{end_s / 3600:6.2f} h  {held}", file=sys.stderr, flush=True)
            yield held
    history.close()


def rows() -> list[Row]:
    """Growth of what the process holds, from a third of the soak to its end."""
    with tempfile.TemporaryDirectory() as folder:
        held = list(_soak(Path(folder)))
    warm, end = held[round(WARM_SHARE * len(held)) - 1], held[-1]
    beside = f"after {HOURS:g} simulated hours: {end.memory_mib:.1f} MiB, {end.objects} objects"
    return [
        Row("resident memory gained", end.memory_mib - warm.memory_mib, "MiB", GROWTH_LIMIT_MIB, peer=beside),
        Row("descriptors gained", end.descriptors - warm.descriptors, "1", 0),
        Row("threads gained", end.threads - warm.threads, "1", 0),
        Row("objects gained", (end.objects - warm.objects) / warm.objects, "1", 0.01),
        Row("store's files", end.file_mib, "MiB", 1.1 * STORE_MIB),
    ]

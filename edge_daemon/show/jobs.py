"""Work that a person starts from the page, in child processes: one at a time, bounded in time, never in the daemon.

Comparing and trying write into a folder of their own. Adding writes the drive's model file, from which the daemon takes
it over by itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import re
import signal
import sys
import tempfile
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edge_daemon.errors import BadInput
from edge_daemon.show.uploads import SUFFIXES, Uploads

log = logging.getLogger(__name__)

LONGEST_S = 300.0
"""A child that takes longer is ended: 60 s of data take some ten seconds on a Raspberry Pi."""
MOST_BYTES = 4_000_000
"""A child's answer has no more bytes."""
MEMORY_KIB = 700 * 1024
"""A child may hold so much: what the unit's MemoryMax of 1 GiB leaves beside the daemon."""
MOST_CPU_S = 400
"""A child that computes for longer is ended even if the daemon that started it is gone."""
LONGEST_STRETCH_S = 300.0
MOST_EXPRESSION = 300
LINES_KEPT = 40
"""So many lines of what a child complains about are kept: a traceback fits."""
BAD_INPUT = 2
"""A child that refuses its input in one line ends with this exit code."""
EFFECT = re.compile(r"[a-z][a-z0-9_]{0,63}(\+[a-z][a-z0-9_]{0,63}){0,3}")
UPLOADS = "uploads"
"""Uploads are kept in this folder beside the store."""


@dataclass(slots=True)
class Job:
    """What runs or has run last."""

    number: int
    kind: str
    drive: str
    share: float = 0.0
    words: str = "starting"
    error: str = ""
    result: Mapping[str, Any] | None = None
    recording: Path | None = None
    made: Path | None = None
    """file that it wrote: a report"""
    running: bool = True
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    def status(self) -> dict[str, Any]:
        """For the page, without the result."""
        return {
            "number": self.number, "kind": self.kind, "drive": self.drive, "share": self.share,
            "words": self.words, "error": self.error, "running": self.running,
        }  # fmt: skip


def bounded(*command: str) -> tuple[str, ...]:
    """A command in a child that is the first to go where memory ends, holds no more than it may, and yields to the
    measurement: whatever it is given to read, the daemon lives."""
    limits = f"ulimit -d {MEMORY_KIB}; ulimit -t {MOST_CPU_S}; ulimit -c 0"
    first_to_go = "echo 1000 2>/dev/null >/proc/self/oom_score_adj"
    return ("/bin/sh", "-c", f'{first_to_go}; {limits}; exec nice -n 19 "$@"', "child", *command)


class Jobs:
    """Starts children and keeps the newest result. `folder` is the gateway's, where recordings may lie."""

    def __init__(self, folder: Path, store: Path) -> None:
        self.folder = folder
        self._store = store
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self.job: Job | None = None
        self._studied: dict[str, Path] = {}
        self.uploads = Uploads(store.parent / UPLOADS)

    def recordings(self) -> list[str]:
        """Names of the recordings in the gateway's folder and of those uploaded, sorted."""
        return sorted(self._files())

    def _files(self) -> dict[str, Path]:
        found = self.uploads.files()
        with contextlib.suppress(OSError):
            rows = (path for path in self.folder.iterdir() if path.suffix in SUFFIXES and path.is_file())
            found |= {path.name: path for path in rows}
        return found

    def look(self, drive: str, model: Path, seconds: float, recording: str | None, until_s: float | None = None) -> Job:
        """Compare and diagnose `seconds` of stored data up to `until_s` (now), or a recording. Raises `BadInput`."""
        if recording is not None:
            files = self._files()
            if recording not in files:
                raise BadInput(f"recording {recording!r}: expected one of {', '.join(files) or '(none)'}")
            file, take = files[recording], []
        else:
            if not 1.0 <= seconds <= LONGEST_STRETCH_S:
                raise BadInput(f"seconds: {seconds:g}: expected 1 to {LONGEST_STRETCH_S:g}")
            file = self._own_folder() / f"{drive}.parquet"
            take = ["--store", str(self._store), "--drive", drive, "--seconds", repr(seconds)]
            take += ["--until", repr(until_s)] if until_s is not None else []
        words = ["look", *take, "--recording", str(file), "--model", str(model)]
        job = self._start("look", drive, words)
        job.recording = file
        return job

    def extend(
        self, drive: str, model: Path, effect: str, expression: str | None, *, write: bool, without: bool = False
    ) -> Job:
        """Add an effect on the data compared last, or take one out (`without`); the model file changes only with
        `write`. Raises `BadInput`."""
        recording = self._compared(drive)
        if not EFFECT.fullmatch(effect):
            raise BadInput(f"effect {effect[:40]!r}: expected names of small letters, digits and _, joined with +")
        if expression is not None and not 0 < len(expression) <= MOST_EXPRESSION:
            raise BadInput(f"expression: {len(expression)} characters: expected 1 to {MOST_EXPRESSION}")
        words = ["extend", effect, "--recording", str(recording), "--model", str(model)]
        words += [f"--expression={expression}"] if expression else []
        words += ["--without"] if without else []
        return self._start("add" if write else "try", drive, [*words, "--write"] if write else words)

    def between(self, drive: str, model: Path, versions: Sequence[str]) -> Job:
        """Two versions of a model side by side, on the data compared last. Raises `BadInput`."""
        words = ["between", *versions, "--recording", str(self._compared(drive)), "--model", str(model)]
        return self._start("between", drive, words)

    def report(self, drive: str, model: Path) -> Job:
        """The report of `edge-daemon diagnose --report`, on the data compared last. Raises `BadInput`."""
        recording = self._compared(drive)
        file = self._own_folder() / f"{drive}.html"
        words = ["report", "--recording", str(recording), "--model", str(model), "--out", str(file)]
        job = self._start("report", drive, words)
        job.made = file
        return job

    def _compared(self, drive: str) -> Path:
        recording = self._studied.get(drive)
        if recording is None or not recording.exists():
            raise BadInput(f"drive {drive}: nothing was compared yet: compare first")
        return recording

    def _start(self, kind: str, drive: str, words: Sequence[str]) -> Job:
        if self.job and self.job.running:
            raise BadInput("something else is being worked out: wait for it")
        job = Job(self.job.number + 1 if self.job else 1, kind, drive)
        job.task = asyncio.create_task(
            self._run(job, bounded(sys.executable, "-m", "edge_daemon.service.model_job", *words))
        )
        self.job = job
        return job

    async def _run(self, job: Job, command: Sequence[str]) -> None:
        try:
            job.result = json.loads(await asyncio.wait_for(self.output_of(job, command), LONGEST_S))
            if job.kind == "look" and job.recording:
                self._studied[job.drive] = job.recording
        except BadInput as error:
            job.error = str(error)
        except TimeoutError:
            job.error = f"took longer than {LONGEST_S:.0f} s and was ended: choose a shorter stretch"
        except (OSError, ValueError) as error:
            job.error = f"failed: {error}"
        finally:
            job.running = False

    async def output_of(self, job: Job, command: Sequence[str]) -> bytes:
        """Standard output of a child that ended well. Raises `BadInput` with its last line otherwise."""
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        child = await asyncio.create_subprocess_exec(
            *command, env=environment, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE, limit=MOST_BYTES,
        )  # fmt: skip
        assert child.stdout is not None and child.stderr is not None
        try:
            output, lines = await asyncio.gather(child.stdout.read(), _follow(job, child.stderr))
            code = await child.wait()
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()
        if code not in (0, BAD_INPUT):
            log.warning("%s of %s ended with %d: %s", job.kind, job.drive, code, " | ".join(lines))
        if code < 0:
            raise BadInput(f"{signal.Signals(-code).name} ended it: out of memory or time: choose a shorter stretch")
        if code != 0 or len(output) > MOST_BYTES:
            raise BadInput(lines[-1] if lines else f"the child process ended with {code}")
        return output

    def _own_folder(self) -> Path:
        if self._scratch is None:
            self._scratch = tempfile.TemporaryDirectory(prefix="edge-daemon-page-")
        return Path(self._scratch.name)

    async def stop(self) -> None:
        """End what runs and remove what was taken from the store."""
        if self.job and self.job.task and not self.job.task.done():
            self.job.task.cancel()
            await asyncio.gather(self.job.task, return_exceptions=True)
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None
        self._studied.clear()


async def _follow(job: Job, stream: asyncio.StreamReader) -> list[str]:
    """Takes progress from a child's standard error; its last other lines."""
    last: deque[str] = deque(maxlen=LINES_KEPT)
    async for raw in stream:
        line = raw.decode(errors="replace").strip()
        share, _, words = line.partition(" ")
        if re.fullmatch(r"[01]\.\d\d", share):
            job.share, job.words = float(share), words
        elif line:
            last.append(line)
    return list(last)

"""Starts a rig process and talks to it: for the demonstration and for tests."""

from __future__ import annotations

import json
import selectors
import subprocess
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import IO, Any, cast

START_WITHIN_S = 30.0
"""A Raspberry Pi imports numpy and pymodbus in some ten seconds when cold."""
ANSWER_WITHIN_S = 10.0
END_WITHIN_S = 5.0


class RigFailed(RuntimeError):
    """The rig ended, or did not answer in time."""


class RigProcess:
    """A rig in a child process; `ready` holds where it can be reached and what is true about it.

    `arguments`: those of `python -m <module>`. Raises `RigFailed`. Ends with the `with` block.
    """

    def __init__(self, arguments: Sequence[str] = (), module: str = "edge_daemon.rig") -> None:
        self._process = subprocess.Popen(  # noqa: S603  (our own interpreter and module)
            [sys.executable, "-m", module, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self._rest = b""
        try:
            self.ready = self._line(START_WITHIN_S)
        except BaseException:
            self.stop()
            raise

    @property
    def pid(self) -> int:
        """Of the child."""
        return self._process.pid

    def order(self, **command: Any) -> dict[str, Any]:
        """Sends one command (see `process`) and returns the answer. Raises `RigFailed`."""
        try:
            pipe = cast("IO[bytes]", self._process.stdin)
            pipe.write(json.dumps(command).encode() + b"\n")
            pipe.flush()
        except (OSError, ValueError) as error:  # a broken pipe, or one that we have closed
            raise RigFailed(f"the rig has ended with {self._process.poll()}") from error
        return self._line(ANSWER_WITHIN_S)

    def stop(self) -> int:
        """Ends the rig by closing its input; by force if it does not. Its exit code."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe:
                pipe.close()
        try:
            return self._process.wait(END_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def __enter__(self) -> RigProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _line(self, within_s: float) -> dict[str, Any]:
        """The next JSON line."""
        pipe = cast("IO[bytes]", self._process.stdout)
        deadline_s = time.monotonic() + within_s
        with selectors.DefaultSelector() as selector:
            selector.register(pipe, selectors.EVENT_READ)
            while b"\n" not in self._rest:
                if not selector.select(max(0.0, deadline_s - time.monotonic())):
                    raise RigFailed(f"the rig did not answer within {within_s:g} s")
                data = pipe.read1(65_536) if hasattr(pipe, "read1") else b""
                if not data:
                    raise RigFailed(f"the rig has ended with {self._process.wait(END_WITHIN_S)}")
                self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return cast("dict[str, Any]", json.loads(line))

"""One function over many files or drives, on Dask: threads of this process, or a cluster at an address."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from edge_daemon.errors import BadInput

Item = TypeVar("Item")
Result = TypeVar("Result")
CONNECT_S = "10s"
"""A scheduler that is there answers within this."""


def mapped(function: Callable[[Item], Result], items: Sequence[Item], scheduler: str | None = None) -> list[Result]:
    """The results in the order of the items, wherever each was computed. Raises `BadInput` where Dask or the scheduler
    is not there."""
    try:
        dask: Any = importlib.import_module("dask")
    except ImportError as error:
        raise BadInput("this needs Dask: pip install edge-daemon[fleet]") from error
    if scheduler is None:
        tasks = [dask.delayed(function)(item) for item in items]
        found: list[Result] = list(dask.compute(*tasks, scheduler="threads", num_workers=os.cpu_count() or 1))
        return found
    return _on_cluster(function, items, scheduler)


def _on_cluster(function: Callable[[Item], Result], items: Sequence[Item], scheduler: str) -> list[Result]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise BadInput("--scheduler needs Dask's cluster: pip install edge-daemon[fleet]") from error
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"--scheduler {scheduler}: nobody answers: expected such as tcp://10.0.0.5:8786") from error
    try:
        return list(client.gather(client.map(function, items, pure=False)))
    finally:
        client.close()

"""What the page may look at beyond the gateway's state, and the little it may do; the daemon fills it in."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_daemon.records import Event


@dataclass(frozen=True, slots=True)
class PageApi:
    """Functions by drive name. Those marked blocking are called in a thread."""

    drive_view: Callable[[str], Mapping[str, Any] | None]
    """spectrum, loop, loads and model of a drive that runs; None for another"""
    what_if: Callable[[str, float], Mapping[str, Any]]
    """remaining life at a multiple of the load so far; blocking; raises `BadInput`"""
    history: Callable[[str, Mapping[str, str]], list[dict[str, Any]]]
    """rows of past estimates; blocking; raises ValueError"""
    trend: Callable[[str, Mapping[str, str]], Mapping[str, Any]]
    """columns of past estimates over a span; blocking; raises ValueError"""
    newest_s: Callable[[], float]
    """time of the newest stored data; NaN where there is none; blocking"""
    events: Callable[[int], Sequence[Event]]
    """the newest stored events, oldest first; blocking"""
    acknowledge: Callable[[str, str | None, str], int]
    """a person (third) has seen one alarm (second) of a drive, or all (None); how many there were"""
    model_file: Callable[[str], Path | None]
    folder: Path
    """of the gateway's files"""
    store: Path
    sharing: Callable[[str], Sequence[str]] = lambda _: ()
    """drives whose model file is that of a drive, itself among them; empty where it has its own"""
    columns: Callable[[Path], Mapping[str, Any]] = lambda _: {"columns": [], "units": {}, "ready": True}
    """what the columns of an uploaded recording may be; blocking; raises `BadInput`"""
    keep_columns: Callable[[Path, Sequence[Mapping[str, Any]]], None] = lambda _path, _rows: None
    """what a person says that they are; blocking; raises `BadInput`"""
    sound: Callable[[str, Mapping[str, str]], Mapping[str, Any]] = lambda _drive, _asked: {}
    """the kept sound of months as levels over time and frequency; blocking; raises ValueError"""
    versions: Callable[[Path], Sequence[Mapping[str, Any]]] = lambda _: ()
    """of a model file, the one in force last; blocking"""
    change_version: Callable[[Path, Mapping[str, Any]], str] = lambda _path, _body: ""
    """undo, name, forget or restore one; blocking; raises `BadInput`"""
    formula: Callable[[str], Mapping[str, Any]] = lambda _: {"error": ""}
    """what the parser says of a formula as it is being written"""
    flush: Callable[[], object] = lambda: None
    """writes to the store what waits; blocking"""

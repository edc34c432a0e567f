"""Columns that are asked for again and again while a recording is explained, the newest of them kept."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable

from edge_daemon.records import Array

KEPT_BYTES = 32 * 2**20
"""So much is kept."""


class ColumnMemory:
    """Columns by name, each as long as what it was computed from is the very same."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, tuple[tuple[object, ...], Array]] = OrderedDict()
        self._bytes = 0

    def get(self, name: Hashable, of: tuple[object, ...], make: Callable[[], Array]) -> Array:
        """(m, k) not to be written to."""
        known = self._kept.get(name)
        if known is not None and all(a is b for a, b in zip(known[0], of, strict=True)):
            self._kept.move_to_end(name)
            return known[1]
        columns = make()
        columns.flags.writeable = False
        self._bytes += columns.nbytes - (known[1].nbytes if known is not None else 0)
        self._kept[name] = of, columns
        self._kept.move_to_end(name)
        while self._bytes > KEPT_BYTES and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1][1].nbytes
        return columns

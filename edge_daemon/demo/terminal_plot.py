"""A curve in a terminal: braille dots, two by four in a character."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bit of each dot by row and column (Unicode, Braille Patterns)."""
BLANK = 0x2800


def curve(
    x: Sequence[float], y: Sequence[float], label: str, marks: Sequence[tuple[float, str]] = (), *,
    columns: int = 72, rows: int = 9, log: bool = False,
) -> str:  # fmt: skip
    """The points joined by lines, largest and smallest value at the axis, and texts under the places of `marks`."""
    points = [(a, b) for a, b in zip(x, y, strict=True) if math.isfinite(b) and (b > 0 or not log)]
    if len(points) < 2:
        return ""
    scale = math.log10 if log else float
    heights = [scale(b) for _, b in points]
    (first, last), (low, high) = (points[0][0], points[-1][0]), (min(heights), max(heights))
    across = (2 * columns - 1) / ((last - first) or 1.0)
    up = (4 * rows - 1) / ((high - low) or 1.0)
    dots = [(round((a - first) * across), round((high - h) * up)) for (a, _), h in zip(points, heights, strict=True)]
    cells = [[0] * columns for _ in range(rows)]
    for (x0, y0), (x1, y1) in itertools.pairwise(dots):
        for px, py in _between(x0, y0, x1, y1):
            cells[py // 4][px // 2] |= DOTS[py % 4][px % 2]
    ends = (f"{max(b for _, b in points):.3g}", f"{min(b for _, b in points):.3g}")
    width = max(map(len, ends))
    lines = [f"{label}"]
    for i, row in enumerate(cells):
        at = ends[0] if i == 0 else ends[1] if i == rows - 1 else ""
        lines.append(f"{at:>{width}} |{''.join(chr(BLANK + cell) for cell in row)}".rstrip(chr(BLANK)))
    lines.append(f"{'':>{width}} +{'-' * columns}")
    lines += [_marked(width + 2 + round((place - first) * across) // 2, text, columns + width) for place, text in marks]
    return "\n".join(lines)


def _between(x0: int, y0: int, x1: int, y1: int) -> list[tuple[int, int]]:
    """Dots of the line from one to the other, both included."""
    n = max(abs(x1 - x0), abs(y1 - y0), 1)
    return [(round(x0 + (x1 - x0) * i / n), round(y0 + (y1 - y0) * i / n)) for i in range(n + 1)]


def _marked(at: int, text: str, width: int) -> str:
    """An arrow under its place, the text on the side where there is room."""
    return f"{'':>{at}}^ {text}" if at + len(text) + 2 <= width else f"{text:>{at - 1}} ^"

"""A self-contained report: one HTML file, works offline, in light and dark and on paper.

Plots are drawn by matplotlib as inline SVG. Under each stand a verdict and what to do next; the words come from whoever
asks for the report, so this module knows nothing of what is plotted.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from edge_daemon.records import Array

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
"""Colour-blind eyes tell these apart (Okabe and Ito, 2008)."""
DASHES = ("solid", "dashed", "dotted", "dashdot", "solid")
"""A black-and-white print tells these apart as well."""
INK = "#123456"
"""This stands for the page's own ink in a drawing, replaced by `currentColor`."""
WIDTH_IN, HEIGHT_IN = 8.0, 3.2
CHARACTER_IN = 0.09
"""A character of a label is this wide on average (10 points)."""
MOST_POINTS = 4000
"""More points of one line or cloud only make the file heavy."""

FIRST_NUMBER = 1000
"""The first page's drawing has this number, beyond those of the sections."""
INNER = (0.5, 99.5)
"""Axes hold this share of the values [percentiles] whole ..."""
BEYOND = 1.5
"""... and so many times their range on either side; a few wild samples would flatten the rest (guess, both)."""
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""The page may load nothing from anywhere, whatever text found its way into it."""


@dataclass(frozen=True, slots=True)
class Line:
    """A curve; `x` and `y` (n,)."""

    x: Array
    y: Array
    label: str = ""
    thin: bool = False


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points; `x` and `y` (n,)."""

    x: Array
    y: Array
    label: str = ""


@dataclass(frozen=True, slots=True)
class Bars:
    """A horizontal bar per name, the first on top; `texts` stand at their ends."""

    names: Sequence[str]
    lengths: Sequence[float]
    texts: Sequence[str]
    intervals: Sequence[tuple[float, float]] = ()
    """(low, high) of each length, drawn as a whisker; empty where not known"""


@dataclass(frozen=True, slots=True)
class Figure:
    """Marks over named axes, units in the names."""

    x: str
    y: str
    marks: Sequence[Line | Cloud | Bars]
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Rows of text under a head."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class ReportSection:
    """One thing to see, what it says, and what to do about it."""

    heading: str
    verdict: str
    next_step: str
    content: Figure | ReportTable | None = None


@dataclass(frozen=True, slots=True)
class FirstPage:
    """What a reader without time takes along."""

    verdict: str
    """one sentence"""
    next_step: str
    facts: Sequence[tuple[str, str]]
    """name and value: of what, from when, how much of it"""
    growth: Figure | None = None
    """before and after in one plot"""


def render_report(title: str, lead: str, sections: Sequence[ReportSection], first: FirstPage | None = None) -> str:
    """The HTML page."""
    body = "\n".join(_section(number, section) for number, section in enumerate(sections))
    body = f"{_first(first)}\n{body}" if first else body
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n"
        f"<body><main><h1>{escape(title)}</h1><p class=lead>{escape(lead)}</p>\n{body}</main></body></html>\n"
    )


def _first(page: FirstPage) -> str:
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in page.facts)
    plot = ""
    if page.growth is not None:
        plot = _picture("before and after", page.growth, FIRST_NUMBER)
    step = f"<p class=next>Next: {escape(page.next_step)}</p>" if page.next_step else ""
    return f"<div class=first><p class=result>{escape(page.verdict)}</p>{step}{plot}<dl>{facts}</dl></div>"


def _section(number: int, section: ReportSection) -> str:
    content = ""
    if isinstance(section.content, Figure):
        content = _picture(section.verdict, section.content, number)
    elif section.content is not None:
        content = _table(section.content)
    step = f"<p class=next>Next: {escape(section.next_step)}</p>" if section.next_step else ""
    return (
        f"<section><h2>{escape(section.heading)}</h2>{content}"
        f"<p class=verdict>{escape(section.verdict)}</p>{step}</section>"
    )


def _picture(label: str, figure: Figure, number: int) -> str:
    """A phone scrolls it sideways, so the keyboard must reach it."""
    return f'<figure tabindex="0" role="img" aria-label="{escape(label)}">{_svg(figure, number)}</figure>'


def _table(table: ReportTable) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in table.head)
    rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return f"<div class=wide tabindex=0><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"


def _svg(figure: Figure, number: int) -> str:
    """The drawing, ink in the page's colour; identifiers are unique within the page."""
    import matplotlib
    from matplotlib.figure import Figure as Drawing

    rows = sum(len(mark.names) for mark in figure.marks if isinstance(mark, Bars))
    style: Any = {
        "svg.fonttype": "none",
        "svg.hashsalt": f"figure {number}",
        "axes.spines.top": False,
        "axes.spines.right": False,
        **{f"{part}.color": INK for part in ("text", "xtick", "ytick")},
        **{f"axes.{part}color": INK for part in ("label", "edge")},
        "grid.alpha": 0.25,
        "axes.grid": True,
        "legend.frameon": False,
    }
    with matplotlib.rc_context(style):
        drawing = Drawing(figsize=(WIDTH_IN, max(HEIGHT_IN, 0.35 * rows + 0.8)), layout="constrained")
        axes = drawing.add_subplot()
        for n, mark in enumerate(figure.marks):
            _draw(axes, mark, COLOURS[n % len(COLOURS)], DASHES[n % len(DASHES)])
        axes.set(xlabel=_plain(figure.x), ylabel=_plain(figure.y))
        if not figure.log_y:
            _steady(axes, figure.marks)
        if figure.log_x:
            axes.set_xscale("log")
        if figure.log_y:
            axes.set_yscale("log")
        if len([mark for mark in figure.marks if getattr(mark, "label", "")]) > 1:
            axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, markerscale=4)
        out = io.StringIO()
        drawing.savefig(out, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = out.getvalue()[out.getvalue().index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL).replace(INK, "currentColor")
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>f{number}-", text)


def _steady(axes: Any, marks: Sequence[Line | Cloud | Bars]) -> None:
    """Leaves single wild values outside, and says how many."""
    found = [mark.y[np.isfinite(mark.y)] for mark in marks if not isinstance(mark, Bars)]
    values = np.concatenate(found) if found else np.empty(0)
    if len(values) < 3:
        return
    low, high = np.percentile(values, INNER)
    room = BEYOND * (high - low)
    outside = int(np.count_nonzero((values < low - room) | (values > high + room)))
    if room > 0 and outside:
        inside = values[(values >= low - room) & (values <= high + room)]
        margin = 0.05 * (inside.max() - inside.min())
        axes.set_ylim(inside.min() - margin, inside.max() + margin)
        axes.set_title(f"{outside} of {len(values)} values lie outside", loc="right", fontsize=9)


def _draw(draw: Any, mark: Line | Cloud | Bars, colour: str, dashes: str) -> None:
    """On matplotlib's axes."""
    if isinstance(mark, Bars):
        _draw_bars(draw, mark, colour)
    elif isinstance(mark, Line):
        x, y = thinned(mark.x, mark.y)
        look = {"linewidth": 0.8} if mark.thin else {"linewidth": 1.6, "linestyle": dashes}
        draw.plot(x, y, color=colour, label=_plain(mark.label), **look)
    else:
        every = max(1, -(-len(mark.x) // MOST_POINTS))
        x, y = mark.x[::every], mark.y[::every]
        draw.scatter(x, y, s=3, color=colour, alpha=0.35, linewidths=0, label=_plain(mark.label), rasterized=True)


def _draw_bars(draw: Any, mark: Bars, colour: str) -> None:
    places = list(range(len(mark.names)))[::-1]
    whiskers = None
    if mark.intervals:
        pairs = list(zip(mark.lengths, mark.intervals, strict=True))
        whiskers = [[max(0.0, at - low) for at, (low, _) in pairs], [max(0.0, high - at) for at, (_, high) in pairs]]
    bars = draw.barh(places, list(mark.lengths), color=colour, height=0.6, xerr=whiskers, ecolor=INK, capsize=3)
    draw.bar_label(bars, labels=[_plain(text) for text in mark.texts], padding=4)
    draw.set_yticks(places, [_plain(name) for name in mark.names])
    draw.margins(x=_room(mark))


def _room(mark: Bars) -> float:
    """Share of the bars' length that is left for the texts at their ends."""
    lines = [line for text in mark.texts for line in text.splitlines()]
    longest_in = CHARACTER_IN * max(map(len, lines), default=0)
    axis_in = WIDTH_IN - CHARACTER_IN * max(map(len, mark.names), default=0)
    share = min(0.75, longest_in / max(axis_in, 1.0))
    return max(0.25, share / (1 - share))


def _plain(text: str) -> str:
    """A dollar sign is a dollar sign: matplotlib would read mathematics between two of them."""
    return text.replace("$", r"\$")


def broken(time_s: Array, *columns: Array) -> tuple[Array, ...]:
    """Time and columns with a NaN between samples that are more than five usual steps apart: a gap is not bridged."""
    if len(time_s) < 3:
        return (time_s, *columns)
    steps = np.diff(time_s)
    gaps = np.flatnonzero(steps > 5 * np.median(steps)) + 1
    return tuple(np.insert(np.asarray(column, dtype=float), gaps, np.nan) for column in (time_s, *columns))


def thinned(x: Array, y: Array) -> tuple[Array, Array]:
    """At most `MOST_POINTS` points of a curve that keep its extremes: the lowest and highest of each stretch, in order.

    Leaving out every n-th point instead would lose the peaks of a spectrum, which are what it is looked at for.
    """
    if len(x) <= MOST_POINTS:
        return x, y
    stretches = np.array_split(np.arange(len(x)), MOST_POINTS // 2)
    filled = np.nan_to_num(y, nan=0.0)
    keep = sorted({int(part[pick(filled[part])]) for part in stretches for pick in (np.argmin, np.argmax)})
    return x[keep], y[keep]


STYLE = """
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;margin:0;background:Canvas;color:CanvasText}
main{max-width:60rem;margin:0 auto;padding:1rem}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin:2rem 0 .5rem}
.lead{font-size:1.15rem}
figure,.wide{margin:0;overflow-x:auto}svg{width:100%;height:auto}
@media screen and (max-width:40rem){svg{width:40rem}}
svg text{font-family:system-ui,sans-serif}
.first{border-left:6px solid #8888;padding:.2rem 1rem;margin:1rem 0}
.result{font-size:1.35rem;font-weight:600;margin:.2rem 0}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1rem;margin:.6rem 0}dt{opacity:.75}dd{margin:0}
.verdict{font-weight:600;margin:.4rem 0}.next{margin:.2rem 0}
table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #8886}
td:not(:first-child){font-variant-numeric:tabular-nums}
@media print{section{break-inside:avoid}.first{break-after:page}}
"""

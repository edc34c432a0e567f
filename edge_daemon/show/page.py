"""The status page: one view of the gateway, as HTML and as JSON for the script that keeps it fresh.

Every changing text has a name. The page is rendered with all of them; the script asks for the same texts by name and
puts them in place, so that nothing is laid out twice. When rows come or go, `layout` changes and the page is
loaded again.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import Any

from edge_daemon.quantities import QUANTITIES
from edge_daemon.records import NE107, Estimate, GatewayState, Snapshot
from edge_daemon.text import fields_of, finite

EVENTS_SHOWN = 20

STATE_WORDS = {
    NE107.OK: "ok",
    NE107.MAINTENANCE_REQUIRED: "maintenance required",
    NE107.OUT_OF_SPECIFICATION: "out of specification",
    NE107.FUNCTION_CHECK: "function check",
    NE107.FAILURE: "failure",
}
_STATUS_WORDS = {
    "valid": "valid",
    "not_excited": "not excited now",
    "warming_up": "warming up",
    "invalid": "invalid",
    "unknown": "unknown",
}


@dataclass(frozen=True, slots=True)
class Cell:
    """A text that changes, and how good the news is: `good`, `warn`, `bad` or `quiet`."""

    text: str
    mood: str = ""


DriveRow = tuple[str, tuple[tuple[str, Cell], ...]]
"""(fixed first column, named cells)"""


@dataclass(frozen=True, slots=True)
class PageTable:
    heading: str
    note: Cell | None
    note_name: str
    columns: tuple[str, ...]
    rows: tuple[DriveRow, ...]


def tables(state: GatewayState, stale_after_s: float) -> list[PageTable]:
    """What the page shows, top to bottom."""
    return [
        *(_drive(snapshot, state, stale_after_s) for snapshot in state.snapshots.values()),
        _sources(state),
        _links(state),
        _tasks(state),
        _events(state),
    ]


def document(state: GatewayState, stale_after_s: float) -> dict[str, Any]:
    """The JSON of /api/state: the state itself, and `page` with the texts by name."""
    shown = tables(state, stale_after_s)
    return {
        "site": state.site,
        "gateway": state.gateway,
        "version": state.version,
        "time_s": state.now_s,
        "up_s": state.now_s - state.started_s,
        "drives": {drive: snapshot_json(snapshot, state.now_s) for drive, snapshot in state.snapshots.items()},
        "sources": [finite(fields_of(row)) for row in state.sources],
        "links": [finite(fields_of(row)) for row in state.links],
        "tasks": [finite(fields_of(row)) for row in state.tasks],
        "events": [finite(fields_of(row)) for row in state.events],
        "page": {
            "layout": _layout(shown),
            "texts": {name: [cell.text, cell.mood] for name, cell in _cells(state, shown)},
        },
    }


def html(state: GatewayState, stale_after_s: float) -> str:
    """The page. Everything that comes from outside is escaped."""
    shown = tables(state, stale_after_s)
    title = escape(f"{state.gateway} · {state.site}")
    body = "\n".join(_table_html(table) for table in shown)
    now = _cell_html("now", dict(_cells(state, shown))["now"], "span")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="/page.css">
<script src="/page.js" defer></script>
</head>
<body data-layout="{_layout(shown)}">
<header><h1>{title}</h1><p>{now} · edge-daemon {escape(state.version)} ·
<a href="/metrics">metrics</a> · <a href="/api/state">JSON</a></p>
<p id="contact" role="status" hidden></p></header>
<main>
{body}
</main>
</body>
</html>
"""


def starting_yet(snapshot: Snapshot, state: GatewayState, stale_after_s: float) -> bool:
    """No data so far, of a gateway that has only just begun: nothing is wrong yet."""
    return math.isnan(snapshot.time_s) and state.now_s - state.started_s <= stale_after_s


def _drive(snapshot: Snapshot, state: GatewayState, stale_after_s: float) -> PageTable:
    age_s = state.now_s - snapshot.time_s
    stale, starting = not age_s <= stale_after_s, starting_yet(snapshot, state, stale_after_s)
    name = f"drive.{snapshot.drive}"
    orders = snapshot.details.get("stiffness", {}).get("orders", ())
    told = [(row.name, row.unit, row.meaning) for row in QUANTITIES.values()]
    told += [(row["name"], row["unit"], row["meaning"]) for row in orders]
    rows = tuple(
        (
            quantity.replace("_", " "),
            (
                *_estimate(f"{name}.{quantity}", snapshot.estimates.get(quantity), unit, stale),
                (f"{name}.{quantity}.meaning", Cell(meaning, "quiet")),
            ),
        )
        for quantity, unit, meaning in told
    )
    words = "; ".join((STATE_WORDS[snapshot.state], *snapshot.reasons))
    if stale:
        age = f"for {age_s:.0f} s" if math.isfinite(age_s) else "yet"
        words = f"no data {age}; {words}"
    mood = (
        "bad"
        if (stale and not starting) or snapshot.state >= NE107.FUNCTION_CHECK
        else "warn"
        if snapshot.state
        else "good"
    )
    columns = ("quantity", "value", "± sd", "unit", "status", "meaning")
    return PageTable(f"Drive {snapshot.drive}", Cell(words, mood), f"{name}.state", columns, rows)


def _estimate(name: str, row: Estimate | None, unit: str, stale: bool) -> tuple[tuple[str, Cell], ...]:
    status = "unknown" if row is None else row.status.value
    usable = row is not None and row.usable and not stale
    value, sd = rounded(row.value, row.sd) if row is not None and usable else ("–", "")
    words = "stale" if stale and row is not None else _STATUS_WORDS[status]
    mood = "" if usable and status == "valid" else "bad" if status == "invalid" else "quiet"
    return (
        (f"{name}.value", Cell(value, mood)),
        (f"{name}.sd", Cell(sd, mood)),
        (f"{name}.unit", Cell(unit if unit != "1" else "", "quiet")),
        (f"{name}.status", Cell(words, mood)),
    )


def rounded(value: float, sd: float) -> tuple[str, str]:
    """Value and sd to two significant digits of the sd; to six digits of the value where the sd is zero.

    With an exponent where both are tiny, or either is huge: a change of 1e-5 +- 0.02 is 0.000.
    """
    if not sd > 0:
        return f"{value:.6g}", "0"
    digits = 1 - math.floor(math.log10(sd))
    size = max(abs(value), sd)
    if size >= 1e6 or size < 1e-3:
        keep = max(0, digits + math.floor(math.log10(abs(value) or sd)))
        return f"{value:.{min(keep, 9)}e}", f"{sd:.1e}"
    places = max(0, digits)
    return f"{round(value, digits) + 0.0:.{places}f}", f"{round(sd, digits):.{places}f}"


_MOODS = {"ok": "good", "running": "good", "finished": "quiet", "off": "quiet", "starting": "warn", "degraded": "warn"}


def _sources(state: GatewayState) -> PageTable:
    rows = tuple(
        (
            row.source,
            (
                (f"source.{row.source}.state", Cell(row.state, _MOODS.get(row.state, "bad"))),
                (f"source.{row.source}.reason", Cell(row.reason)),
                (f"source.{row.source}.age", Cell(_ago(state.now_s - row.last_s))),
                (f"source.{row.source}.counters", Cell(_figures(row.counters), "quiet")),
            ),
        )
        for row in state.sources
    )
    return PageTable("Sources", None, "", ("source", "state", "reason", "newest reading", "counters"), rows)


def _links(state: GatewayState) -> PageTable:
    rows = tuple(
        (
            row.link,
            (
                (f"link.{row.link}.state", Cell(row.state, _MOODS.get(row.state, "bad"))),
                (f"link.{row.link}.reason", Cell(row.reason)),
                (f"link.{row.link}.figures", Cell(_figures(row.figures), "quiet")),
            ),
        )
        for row in state.links
    )
    return PageTable("Ways out", None, "", ("link", "state", "reason", "figures"), rows)


def _tasks(state: GatewayState) -> PageTable:
    rows = tuple(
        (
            row.name,
            (
                (f"task.{row.name}.state", Cell(row.state, _MOODS.get(row.state, "bad"))),
                (f"task.{row.name}.restarts", Cell(str(row.restarts))),
                (f"task.{row.name}.reason", Cell(row.reason)),
            ),
        )
        for row in state.tasks
    )
    return PageTable("Tasks", None, "", ("task", "state", "restarts", "last failure"), rows)


def _events(state: GatewayState) -> PageTable:
    moods = {NE107.OK: "quiet", NE107.FAILURE: "bad"}
    rows = tuple(
        (
            _clock(row.time_s),
            (
                (f"event.{n}.drive", Cell(row.drive or "gateway")),
                (f"event.{n}.severity", Cell(STATE_WORDS[row.severity], moods.get(row.severity, "warn"))),
                (f"event.{n}.source", Cell(row.source)),
                (f"event.{n}.message", Cell(row.message)),
            ),
        )
        for n, row in enumerate(reversed(state.events[-EVENTS_SHOWN:]))
    )
    return PageTable("Events", None, "", ("time (UTC)", "drive", "severity", "from", "what"), rows)


def _cells(state: GatewayState, shown: list[PageTable]) -> Iterator[tuple[str, Cell]]:
    yield "now", Cell(f"{_clock(state.now_s)} UTC, up {_ago(state.now_s - state.started_s)}")
    for table in shown:
        if table.note:
            yield table.note_name, table.note
        for _, cells in table.rows:
            yield from cells


def _layout(shown: list[PageTable]) -> str:
    """Changes when rows come or go: their fixed parts, hashed."""
    fixed = repr(
        [(table.heading, [(first, [name for name, _ in cells]) for first, cells in table.rows]) for table in shown]
    )
    return hashlib.sha256(fixed.encode()).hexdigest()[:16]


def _table_html(table: PageTable) -> str:
    head = "".join(f"<th scope=col>{escape(column)}</th>" for column in table.columns)
    rows = "\n".join(
        f"<tr><th scope=row>{escape(first)}</th>{''.join(_cell_html(name, cell, 'td') for name, cell in cells)}</tr>"
        for first, cells in table.rows
    )
    note = _cell_html(table.note_name, table.note, "p") if table.note else ""
    return f"""<section><h2>{escape(table.heading)}</h2>{note}
<table><thead><tr>{head}</tr></thead><tbody>
{rows}
</tbody></table></section>"""


def _cell_html(name: str, cell: Cell, tag: str) -> str:
    return f'<{tag} data-name="{escape(name)}" data-mood="{cell.mood}">{escape(cell.text)}</{tag}>'


def _figures(figures: Mapping[str, float]) -> str:
    return ", ".join(
        f"{name} {value:g}" if abs(value) >= 1e7 else f"{name} {value:.10g}" for name, value in figures.items()
    )


def _clock(time_s: float) -> str:
    if not math.isfinite(time_s):
        return "–"
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M:%S")


def _ago(age_s: float) -> str:
    if not math.isfinite(age_s):
        return "never"
    for seconds, unit in ((86_400, "d"), (3600, "h"), (60, "min")):
        if age_s >= 2 * seconds:
            return f"{age_s / seconds:.0f} {unit}"
    return f"{max(0.0, age_s):.1f} s"


def snapshot_json(snapshot: Snapshot, now_s: float) -> dict[str, Any]:
    """One drive as JSON; a number that is not usable is null."""
    document: dict[str, Any] = finite(
        {
            "sequence": snapshot.sequence,
            "time_s": snapshot.time_s,
            "age_s": now_s - snapshot.time_s,
            "state": snapshot.state.name.lower(),
            "ne107": int(snapshot.state),
            "reasons": list(snapshot.reasons),
            "estimates": {
                name: {
                    "value": row.value if row.usable else math.nan,
                    "sd": row.sd if row.usable else math.nan,
                    "unit": row.unit,
                    "status": row.status.value,
                    "time_s": row.time_s,
                }
                for name, row in snapshot.estimates.items()
            },
        }
    )
    return document

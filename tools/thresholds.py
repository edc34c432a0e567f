"""Writes docs/thresholds.md: every constant of the package that is a guess, and what would replace the guess.

    .venv/bin/python tools/thresholds.py

A constant is a guess where its docstring says "(guess". Run after a guess was added, changed or replaced.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGE, PAGE = ROOT / "edge_daemon", ROOT / "docs" / "thresholds.md"
REPLACED_BY = {
    "": "clock steps counted on gateways in the field",
    "acquire": "counts of late, lost and repeated readings from buses and parts in the field",
    "recordings": "files of further machines",
    "balance": "recordings of machines whose channels were timed",
    "commands": "what users do after they read the line",
    "compensate": "output errors of drives in the field, with compensation and without",
    "condition": "flaws counted on drives in the field, by channel and sensor",
    "config": "the configurations that installers write",
    "design": "stresses, stiffness and life measured on flexsplines whose drawing is known",
    "discover": "recordings of machines whose missing law is known",
    "effects": "fits of the effect on measured gears",
    "search": "recordings of machines whose cause is known (`tools/bench.py explain belief real`)",
    "explain": "recordings of machines whose cause is known (`tools/bench.py explain belief real`)",
    "encoders": "angles of encoders in the field, healthy and failing",
    "excite": "motions of real drives",
    "faults": "drifts of gears whose fault was found when they were opened",
    "fleet": "fleets in the field, and who reads their data (`tools/bench.py fleet`)",
    "identify": "fits on recordings of machines whose truth is known",
    "stiffness": "stands on which a gear of known stiffness is loaded",
    "motion": "recordings of drives in the field",
    "health": "months of drives whose gears were opened: which alarm was right, and which came too late",
    "prognose": "histories of gears that were run until they failed (`edge-daemon learn`)",
    "publish": "clients counted on gateways in the field",
    "rig": "measurements of real sensors and machines",
    "servo": "measurements of real drives",
    "service": "gateways in the field",
    "show": "browsers in the field",
    "sound": "sound of gears in the field",
    "store": "sizes of stores in the field",
    "track": "long recordings of drives in the field (`tools/bench.py estimate_truth scenarios`)",
    "usage": "gears run to their end at known loads",
}
HEAD = """# Guesses

Every threshold in the product is derived, measured, or a guess. These are the guesses: what each one says, and what
would replace it. Written by `tools/thresholds.py`; do not edit.
"""


class Guess(NamedTuple):
    """One constant that nobody derived or measured yet."""

    place: str
    name: str
    value: str
    reason: str


def guesses(path: Path) -> Iterator[Guess]:
    """Those of one module."""
    body = ast.parse(path.read_text()).body
    for node, after in itertools.pairwise(body):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or not isinstance(after, ast.Expr):
            continue
        text = after.value.value if isinstance(after.value, ast.Constant) else None
        if isinstance(text, str) and "(guess" in text and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            place = str(path.relative_to(PACKAGE))
            yield Guess(place, ast.unparse(target).strip("()"), ast.unparse(node.value), " ".join(text.split()))


def page() -> str:
    """The whole page."""
    rooms: dict[str, list[Guess]] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        room = path.relative_to(PACKAGE).parts[0] if path.parent != PACKAGE else ""
        rooms.setdefault(room, []).extend(guesses(path))
    parts = [HEAD]
    for room, rows in rooms.items():
        if rows:
            parts.append(f"## {room or 'the vocabulary'}\n\nReplaced by: {REPLACED_BY[room]}.\n")
            parts.append("| constant | value | what it says |\n|---|---|---|")
            parts += [f"| `{row.name}` ({row.place}) | `{row.value[:60]}` | {_cell(row.reason)} |" for row in rows]
            parts.append("")
    return "\n".join(parts).rstrip() + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page())
    print(f"{PAGE}: {page().count(chr(10) + '| `')} guesses")

"""Figures that depend on the machine, as ratios to a limit or to a peer in the same run.

    .venv/bin/python tools/bench.py                 every subject
    .venv/bin/python tools/bench.py estimate store  some of them

Each subject is a module bench_SUBJECT.py beside this file with `rows() -> list[Row]`. A missed limit is printed and
makes the exit code 1; nothing here runs in the tests.
"""

from __future__ import annotations

import importlib
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

FOLDER = Path(__file__).parent
sys.path[:0] = [str(FOLDER), str(FOLDER.parent)]

from bench_row import HEAD, cells  # noqa: E402

from edge_daemon.text import table  # noqa: E402


def subjects() -> list[str]:
    """What can be measured."""
    return sorted(path.stem.removeprefix("bench_") for path in FOLDER.glob("bench_*.py") if path.stem != "bench_row")


def main(wanted: list[str]) -> int:
    """Prints a table per subject; 1 if any limit was missed, 2 for an unknown subject."""
    unknown = [name for name in wanted if name not in subjects()]
    if unknown:
        print(f"bench: {unknown[0]}: expected some of {', '.join(subjects())}", file=sys.stderr)
        return 2
    missed = 0
    for name in wanted or subjects():
        began = time.perf_counter()
        rows = list(importlib.import_module(f"bench_{name}").rows())
        missed += sum(row.verdict == "MISSED" for row in rows)
        print(f"\n{name}, {time.perf_counter() - began:.0f} s\n{table(HEAD, map(cells, rows))}", flush=True)
    print(f"\n{missed} limits missed" if missed else "\nall limits kept")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

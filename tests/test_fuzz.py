"""Damaged bytes for every reader of what comes from outside; `tools/fuzz.py` takes more than the few of here."""

import sys
from pathlib import Path

import pytest

from edge_daemon.errors import LONGEST_REFUSAL, BadInput

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import fuzz

FEW = {
    **{
        "prior": 40,
        "spectrum": 100,
        "sound": 60,
        "configuration": 200,
        "DBC": 100,
        "command line": 100,
        "history": 150,
    },
    **{"fleet's prior": 60, "fleet's dataset": 100, "fleet's message": 600, "life's checkpoint": 300, "drawing": 150},
    **{"recording": 200, "parquet": 200, "gear": 300, "CAN log": 400},
}
"""Of readers that take a millisecond or more; the others see 1200 each."""


@pytest.mark.parametrize("name", fuzz.TARGETS)
def test_damaged_input_is_taken_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    counts = fuzz.run(name, iter(range(FEW.get(name, 1200))), tmp_path)
    assert counts["taken"] + counts["refused"] > 0
    assert not counts["fault"], [text for text in counts if text.startswith("seed")]


def test_the_harness_finds_what_it_looks_for(tmp_path: Path) -> None:
    def careless(data: bytes, _: Path) -> float:
        return float(data)

    with pytest.raises(fuzz.Fault, match="ValueError"):
        fuzz.tried(fuzz.Target(lambda: [b"1"], careless), b"one", tmp_path / "input")


def test_a_refusal_breaks_no_line_commands_no_terminal_and_has_an_end() -> None:
    line = str(BadInput("key: 'a\nb\x1b[31m\u202e': expected " + "x" * 10_000))
    assert line.isprintable() and len(line) < LONGEST_REFUSAL + 10
    assert line.startswith("key: 'a b [31m") and line.endswith("xxx")

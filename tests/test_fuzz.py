"""Damaged bytes for every reader of what comes from outside; `tools/fuzz.py` takes more than the few of here."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.errors import LONGEST_REFUSAL, BadInput

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import fuzz

FEW = {
    **{
        "prior": 15,
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
FOUND = {
    "life's checkpoint": [224055, 252522, 14114, 250400, 59613, 41147, 54487, 68071, 221460, 104293, 188451],
    "fleet's prior": [3233, 3597],
    "stored blocks": [593240],
    "DBC": [10000674, 10003613, 10004394, 10010324, 10009864, 10009876],
    "configuration": [10002043],
    "spectrum": [10022565],
    "fleet's dataset": [10008959],
}
"""Archives of another version, encrypted or with a header that is no Python; numbers whose products are too large;
signals before the first bit of a message or longer than memory, factors that are no floats; whole numbers that Python
does not print; times whose middle step is like none; words of a data set that are not UTF-8."""


@pytest.mark.slow
@pytest.mark.parametrize("name", fuzz.TARGETS)
def test_damaged_input_is_taken_or_refused_in_one_line(name: str, tmp_path: Path) -> None:
    counts = fuzz.run(name, iter(range(FEW.get(name, 1200))), tmp_path)
    assert counts["taken"] + counts["refused"] > 0
    assert not counts["fault"], [text for text in counts if text.startswith("seed")]


@pytest.mark.parametrize(("name", "seeds"), FOUND.items())
def test_what_a_long_run_found_stays_mended(name: str, seeds: list[int], tmp_path: Path) -> None:
    counts = fuzz.run(name, iter(seeds), tmp_path)
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


@pytest.mark.parametrize("words", [["registers", "--form\nat"], ["export", "--store", "a" * 5000, "--out", "x.csv"]])
def test_what_is_typed_is_refused_in_one_line(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        sys.exit(main(words))
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and said.startswith("edge-daemon: ")
    assert len(said) < 2 * LONGEST_REFUSAL


def test_a_link_to_itself_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    for words in (["life", str(loop), "--gear", "CSG-20-100"], ["check", str(loop)], ["noise", str(loop)]):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and str(loop) in said


def test_a_learned_prior_without_scatter_or_beyond_all_numbers_is_refused() -> None:
    """It would be a root of less than nothing, or an overflow, in every forecast."""
    from edge_daemon.prognose.learn import LearnError, prior_from_bytes

    (whole,) = fuzz.TARGETS["prior"].examples()
    prior_from_bytes(whole)
    known = json.loads(whole)
    told = np.array([1.0, 1.0, 1.0])
    flat = np.outer(told, told) + np.diag([1e-16, 1e-16, 1e-16])
    target = [1e200, *known["experience"]["target"][1:]]
    for wrong in ({"noise_cover": flat.tolist()}, {"experience": known["experience"] | {"target": target}}):
        with pytest.raises(LearnError, match="learned prior: "):
            prior_from_bytes(json.dumps(known | wrong).encode())

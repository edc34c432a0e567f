"""How commands print."""

from __future__ import annotations

import pytest

from edge_daemon.demo.terminal_plot import curve
from edge_daemon.text import WIDTH, indented, number, painted, said, table, time_left, with_sd


def test_a_table_aligns_words_left_and_numbers_right() -> None:
    assert table(("name", "value"), [("a", "1.5"), ("longer", "12")]) == (
        "name    value\n------  -----\na         1.5\nlonger     12"
    )


def test_a_long_reason_stays_below_its_heading_within_a_terminal() -> None:
    lines = indented("The stiffness has fallen " + "and so on " * 30).splitlines()
    assert len(lines) > 2 and all(line.startswith("  ") and len(line) <= WIDTH for line in lines)


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (100_234.567, 120.0, "100230 ± 120"),
        (12.3456, 0.5, "12.35 ± 0.5"),
        (2.637e9, 1.2e6, "2.637e+09 ± 1200000"),
        (0.001, 0.5, "0.001 ± 0.5"),
        (float("nan"), 1.0, "-"),
        (5.0, float("nan"), "5"),
    ],
)
def test_a_value_is_no_finer_than_its_standard_deviation_deserves(value: float, sd: float, shown: str) -> None:
    assert with_sd(value, sd) == shown


def test_a_number_that_is_none_is_a_dash() -> None:
    assert number(float("inf")) == "-"


@pytest.mark.parametrize(
    ("who", "what", "line"),
    [
        ("clock", "set back by 3 s", "clock: set back by 3 s"),
        ("source can0", "source can0 is down", "source can0 is down"),
        ("source can0", "cleared: source can0 is down", "cleared: source can0 is down"),
        ("source can0", "can0: the serial port is closed", "source can0: the serial port is closed"),
    ],
)
def test_a_line_of_the_journal_names_nobody_twice(who: str, what: str, line: str) -> None:
    assert said(who, what) == line


def test_a_long_text_is_wrapped_and_no_number_is_broken() -> None:
    words = "a finer encoder or more torque is needed to tell it " * 4
    lines = table(("value", "advice", "note"), [("1234567.5", words, "short"), ("2", "none", "")]).splitlines()
    assert max(map(len, lines)) <= WIDTH and "1234567.5" in lines[2]
    assert " ".join(" ".join(line[11:].split()) for line in lines[2:-1]).replace("short ", "") == words.strip()


def test_colour_is_for_terminals_whose_owner_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal:
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert painted("bad", "bad", Terminal()) == "\033[31mbad\033[0m"  # type: ignore[arg-type]
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("bad", "bad", Terminal()) == "bad"  # type: ignore[arg-type]
    monkeypatch.delenv("NO_COLOR")
    assert painted("bad", "bad") == "bad", "pytest's output is no terminal"


@pytest.mark.parametrize(
    ("spent_s", "share", "words"),
    [(1.0, 0.5, ""), (10.0, 0.25, ", 30 s left"), (300.0, 0.5, ", 5 min left"), (10.0, 1.0, ""), (10.0, 0.0, "")],
)
def test_what_takes_long_says_how_long_it_will_take(spent_s: float, share: float, words: str) -> None:
    assert time_left(spent_s, share) == words


def test_a_curve_has_its_ends_at_the_axis_and_its_mark_below() -> None:
    """A fall by a decade half way: the upper half of the dots before the mark, the lower after it."""
    drawn = curve(range(101), [10.0] * 50 + [1.0] * 51, "error [%]", [(50.0, "added")], columns=40, rows=8, log=True)
    head, *rows, _, mark = drawn.splitlines()
    assert head == "error [%]" and rows[0].startswith("10 |") and rows[-1].startswith(" 1 |")
    dots = [[cell not in (" ", chr(0x2800)) for cell in row[4:].ljust(40)] for row in rows]
    assert all(dots[0][:20]) and not any(dots[0][21:]) and all(dots[-1][20:]) and not any(dots[-1][:19])
    assert mark.index("^") == 4 + 20 and mark.endswith("added")


def test_a_curve_of_one_point_is_none() -> None:
    assert curve([0.0, 1.0], [float("nan"), 1.0], "error") == ""

"""How commands print."""

from __future__ import annotations

import pytest

from edge_daemon.text import number, said, table, with_sd


def test_a_table_aligns_words_left_and_numbers_right() -> None:
    assert table(("name", "value"), [("a", "1.5"), ("longer", "12")]) == (
        "name    value\n------  -----\na         1.5\nlonger     12"
    )


@pytest.mark.parametrize(
    ("value", "sd", "shown"),
    [
        (100_234.567, 120.0, "1.0023e+05 ± 1.2e+02"),
        (12.3456, 0.5, "12.35 ± 0.5"),
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

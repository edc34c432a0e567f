"""Spans of numbers beside a plain set of them."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from edge_daemon.fleet.dataset import packed_numbers, unpacked_numbers
from edge_daemon.fleet.spans import Spans, StreamNumbers, joined

NUMBERS = st.lists(st.integers(0, 60), max_size=80)


def spans_of(numbers: list[int]) -> Spans:
    spans = Spans()
    for number in numbers:
        spans.add(number, 10.0 * number)
    return spans


@given(NUMBERS)
def test_a_number_is_new_once_and_there_for_ever(numbers: list[int]) -> None:
    spans, known = Spans(), set[int]()
    for number in numbers:
        assert bool(spans.add(number, 0.0)) == (number not in known)
        known.add(number)
    assert len(spans) == len(known) and all((n in spans) == (n in known) for n in range(62))


@given(NUMBERS, st.integers(0, 60), st.integers(0, 60))
def test_what_is_missing_is_what_a_set_would_miss(numbers: list[int], first: int, last: int) -> None:
    found = {n for begin, end in spans_of(numbers).missing(first, last) for n in range(begin, end + 1)}
    assert found == set(range(first, last + 1)) - set(numbers)


@given(NUMBERS)
def test_holes_lie_below_the_highest_and_know_their_neighbours_times(numbers: list[int]) -> None:
    found = set()
    for first, last, before_s, after_s in spans_of(numbers).holes():
        found |= set(range(first, last + 1))
        assert after_s == 10.0 * (last + 1)
        assert before_s == 10.0 * (first - 1) if first else math.isnan(before_s)
    assert found == set(range(max(numbers, default=0))) - set(numbers)


@given(NUMBERS, NUMBERS)
def test_joining_is_the_union_and_survives_being_packed(left: list[int], right: list[int]) -> None:
    mine: StreamNumbers = {"a/b/c/life": {7: spans_of(left)}} if left else {}
    joined(mine, {"a/b/c/life": {7: spans_of(right)}, "a/b/d/load": {8: spans_of(right)}} if right else {})
    again = unpacked_numbers(packed_numbers(mine))
    there = again.get("a/b/c/life", {}).get(7, Spans())
    assert {n for first, last, _, _ in there for n in range(first, last + 1)} == set(left) | set(right)

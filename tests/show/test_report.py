"""The offline report: nothing from elsewhere, units on every axis, and the peaks that were in the data."""

from __future__ import annotations

import re
import warnings
from html.parser import HTMLParser

import numpy as np
import pytest

from edge_daemon.show.report import (
    Bars,
    Cloud,
    Figure,
    FirstPage,
    Line,
    ReportSection,
    ReportTable,
    broken,
    render_report,
    thinned,
)

TIME_S = np.arange(20_000) / 1000
TORQUE = 40 * np.sin(2 * np.pi * 0.5 * TIME_S)
HOSTILE = '<script>alert("x")</script>'


def sections() -> list[ReportSection]:
    ranking = Bars(["backlash", "hysteresis"], [2.0, 3.0], ["2 %", "3 %"], [(1.5, 2.5), (2.0, 4.5)])
    return [
        ReportSection(
            "Measured and modelled",
            "misses 5 %",
            "diagnose",
            Figure(
                "time [s]", "torque [N m]", [Line(TIME_S, TORQUE, "measured"), Line(TIME_S, TORQUE * 0.9, "modelled")]
            ),
        ),
        ReportSection(
            "Residual", "twice per turn", "", Figure("angle [rad]", "residual [N m]", [Cloud(TIME_S, TORQUE)])
        ),
        ReportSection("Ranking", "backlash", "add it", Figure("error [%]", "", [ranking])),
        ReportSection("Parameters", "identified", "", ReportTable(("name", "value"), [("stiffness", HOSTILE)])),
    ]


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "data"):
                self.addresses.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)

    def handle_data(self, data: str) -> None:
        self.words.append(data.strip())


@pytest.fixture(scope="module")
def page() -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return render_report(f"joint 1 {HOSTILE}", "lead", sections())


def test_the_page_loads_nothing_and_runs_nothing(page: str) -> None:
    found = Page(page)
    assert not {"script", "link", "iframe", "object", "embed"} & set(found.tags)
    assert [row for row in found.addresses if not row.startswith(("#", "data:image/png;base64,"))] == []
    assert not re.search(r"url\((?!#)", page) and "@import" not in page
    assert "default-src 'none'" in page
    assert HOSTILE in found.words


def test_every_plot_has_units_a_verdict_and_a_next_step(page: str) -> None:
    words = Page(page).words
    for text in ("time [s]", "torque [N m]", "angle [rad]", "residual [N m]", "error [%]"):
        assert text in words, text
    for section in sections():
        assert section.verdict in words
        if section.next_step:
            assert f"Next: {section.next_step}" in words
    assert {"measured", "modelled", "2 %", "3 %", "backlash"} <= set(words)
    assert page.count("<svg") == 3


def test_identifiers_are_unique_and_every_reference_finds_its_own(page: str) -> None:
    found = Page(page)
    assert len(found.ids) == len(set(found.ids))
    wanted = set(re.findall(r"url\(#([^)]+)\)", page)) | {row[1:] for row in found.addresses if row.startswith("#")}
    assert wanted and wanted <= set(found.ids)


def test_the_same_data_gives_the_same_file(page: str) -> None:
    assert render_report(f"joint 1 {HOSTILE}", "lead", sections()) == page


def test_ink_follows_the_readers_theme(page: str) -> None:
    assert "currentColor" in page and "#123456" not in page
    assert "color-scheme:light dark" in page and "@media print" in page


def test_a_long_record_stays_a_small_file() -> None:
    long_s = np.arange(1_000_000) / 1000
    marks = [Line(long_s, np.sin(long_s)), Cloud(long_s, np.sin(long_s))]
    assert len(render_report("t", "", [ReportSection("a", "b", "", Figure("t [s]", "y [1]", marks))])) < 500_000


def test_a_single_peak_of_a_long_spectrum_survives_thinning() -> None:
    amplitude = np.full(100_001, 1e-6)
    amplitude[77_777] = 1.0
    at, kept = thinned(np.arange(100_001.0), amplitude)
    assert len(at) <= 4000
    assert at[np.argmax(kept)] == 77_777 and kept.max() == 1.0
    assert np.all(np.diff(at) > 0)


def test_a_short_curve_is_not_touched() -> None:
    x, y = thinned(TIME_S[:100], TORQUE[:100])
    assert x is not TIME_S and np.array_equal(x, TIME_S[:100]) and np.array_equal(y, TORQUE[:100])


@pytest.mark.parametrize(
    "figure",
    [
        Figure("x [1]", "y [1]", []),
        Figure("x [1]", "y [1]", [Line(np.array([]), np.array([]))]),
        Figure("x [1]", "y [1]", [Line(TIME_S, np.full_like(TIME_S, np.nan))]),
        Figure("x [1]", "y [1]", [Line(TIME_S, TORQUE, f"part {n}") for n in range(7)]),
        Figure("x [Hz]", "y [N m]", [Line(TIME_S[1:], np.abs(TORQUE[1:]))], log_x=True, log_y=True),
        Figure("cost $ per $ [1]", "y [1]", [Bars(["$a$", "_b"], [0.0, 1.0], ["", ""])]),
    ],
)
def test_odd_figures_are_drawn_all_the_same(figure: Figure) -> None:
    text = render_report("t", "", [ReportSection("a", "b", "", figure)])
    assert text.count("<svg") == 1
    assert all(word in Page(text).words for word in (figure.x, figure.y) if word)


def test_seven_curves_are_all_drawn() -> None:
    marks = [Line(TIME_S, TORQUE + n, f"part {n}") for n in range(7)]
    words = Page(render_report("t", "", [ReportSection("a", "b", "", Figure("t [s]", "y [1]", marks))])).words
    assert {f"part {n}" for n in range(7)} <= set(words)


def test_ticks_of_a_logarithmic_axis_are_numbers() -> None:
    figure = Figure("f [Hz]", "a [1]", [Line(TIME_S[1:], TIME_S[1:] ** 2)], log_y=True)
    text = render_report("t", "", [ReportSection("a", "b", "", figure)])
    assert "mathdefault" not in text


def test_a_gap_in_time_breaks_the_curve_and_nothing_else_does() -> None:
    time_s = np.concatenate([TIME_S[:50], TIME_S[500:550]])
    at, value = broken(time_s, np.arange(100))
    assert np.flatnonzero(np.isnan(at)).tolist() == np.flatnonzero(np.isnan(value)).tolist() == [50]
    assert np.array_equal(value[~np.isnan(value)], np.arange(100))
    assert len(broken(TIME_S[:50], np.arange(50))[0]) == 50


def test_a_few_wild_samples_do_not_flatten_a_plot_and_are_counted() -> None:
    wild = TORQUE.copy()
    wild[[100, 2000, 15_000]] = 2e4
    drawn = render_report("t", "l", [ReportSection("A", "b", "", Figure("x", "y", [Cloud(TIME_S, wild)]))])
    assert f"3 of {len(wild)} values lie outside" in drawn
    assert ">20000<" not in drawn and ">40<" in drawn
    tame = render_report("t", "l", [ReportSection("A", "b", "", Figure("x", "y", [Cloud(TIME_S, TORQUE)]))])
    assert "lie outside" not in tame


def test_the_first_page_says_the_verdict_before_all_else_and_ends_with_a_page() -> None:
    growth = Figure("error [%]", "", [Bars(["before", "after"], [7.0, 0.2], ["7 %", "0.2 %"])])
    first = FirstPage(f"It misses 7 % {HOSTILE}", "add it", [("date", "2026-11-22"), ("duration", "20 s")], growth)
    drawn = render_report("t", "lead", sections(), first)
    assert drawn.index("It misses 7 %") < drawn.index("<section>") and HOSTILE not in drawn
    assert "<dt>duration</dt><dd>20 s</dd>" in drawn and "0.2 %" in drawn
    assert ".first{break-after:page}" in drawn and len(re.findall(r'id="([^"]+)"', drawn)) == len(
        set(re.findall(r'id="([^"]+)"', drawn))
    )

"""The report's pages: what an engineer reads on them, on a drive with one encoder and on a doubtful diagnosis."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.explain.results import Candidate, Diagnosis, Error, OrderSpectrum, Proposal, SeenCurve
from edge_daemon.service.model_report import diagnosed_sections, missing_sentence, proposed_sections, spectrum_section
from edge_daemon.show.report import Bars, Figure


@pytest.fixture(scope="module")
def one_encoder(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The report of a comparison of motor current with motion, as text with its tags."""
    folder = tmp_path_factory.mktemp("report")
    rec, model, page = (str(folder / name) for name in ("drive.csv", "drive.toml", "page.html"))
    words = ["simulate", "--balance", "drive", "--effect", "coulomb_friction", "--seconds", "12"]
    assert main([*words, "--out", rec, "--model", model]) == 0
    assert main(["compare", rec, "--model", model, "--report", page]) == 0
    return Path(page).read_text()


@pytest.mark.slow
def test_a_drive_with_one_encoder_gets_no_empty_torque_over_twist(one_encoder: str) -> None:
    assert "Measured and modelled" in one_encoder and "Torque over twist" not in one_encoder


def test_what_is_compared_is_called_what_its_unit_says(one_encoder: str) -> None:
    units = set(re.findall(r"residual \[([^]]+)\]", one_encoder))
    assert units in ({"A"}, {"N m"})
    assert ("motor current [A]" in one_encoder) == (units == {"A"}) and "torque [A]" not in one_encoder


def test_a_wide_table_scrolls_by_itself_on_a_phone(one_encoder: str) -> None:
    assert one_encoder.count("<div class=wide tabindex=0><table>") == one_encoder.count("<table>") > 0


def test_the_first_page_holds_what_a_customer_asks(one_encoder: str) -> None:
    first = one_encoder.partition("<section>")[0]
    assert "times sensor noise." in first and "Next: edge-daemon diagnose" in first
    facts = dict(re.findall(r"<dt>([^<]+)</dt><dd>([^<]+)</dd>", first))
    assert facts.keys() >= {"date", "duration", "rate", "model", "known", "tool"}
    assert float(facts["duration"].split()[0]) == pytest.approx(12.0, rel=0.1)
    assert "±" in facts["known"]


def spectrum_of(amplitude: np.ndarray) -> str:
    """What is said of it."""
    return spectrum_section(
        OrderSpectrum("frequency", np.arange(1.0, 1.0 + len(amplitude)), amplitude), "N m", False
    ).verdict


def test_a_spectrum_names_a_cause_only_for_what_stands_out_of_it() -> None:
    noise = np.random.default_rng(5).rayleigh(1e-3, 2000)
    assert spectrum_of(noise).endswith("but at the level of the noise around it.")
    line = noise.copy()
    line[49] = 0.02
    assert (
        spectrum_of(line) == "The residual is largest at 50 Hz: a resonance or an outside torque would look like this."
    )


def test_none_of_them_stands_beside_the_others() -> None:
    error = Error(0.09, 0.06, 0.26, "A")
    (section,) = diagnosed_sections(Diagnosis("missing", error, (candidate(0.9),), None, ()))
    assert isinstance(section.content, Figure)
    (bars,) = section.content.marks
    assert isinstance(bars, Bars) and bars.names[-1] == "none of them" and bars.texts[-1] == "p = 0.10"


def candidate(probability: float) -> Candidate:
    return Candidate("gravity_load", 0.09, 0.08, probability, ("wave_generator_ripple",), {})


def test_a_name_that_is_hardly_more_than_a_guess_is_called_one() -> None:
    assert missing_sentence(candidate(0.9)) == "Missing: gravity_load."
    assert "no more than a guess" in missing_sentence(candidate(0.25)) and "0.25" in missing_sentence(candidate(0.25))


def test_a_diagnosis_does_not_send_to_the_diagnosis() -> None:
    error = Error(0.09, 0.06, 0.26, "A")
    (section,) = diagnosed_sections(Diagnosis("missing", error, (candidate(0.9),), None, ()))
    assert section.next_step == "edge-daemon add gravity_load"


def test_a_formula_stands_beside_the_curve_that_was_seen() -> None:
    at = np.linspace(-1.0, 1.0, 9)
    curve = SeenCurve("velocity_out_rad_s", at, at + 0.01, at)
    seen = {"velocity_out_rad_s": (-1.0, 1.0)}
    row = Proposal("a*velocity_out_rad_s", "a drag", 0.01, 0.9, seen, resembles="viscous_friction", curve=curve)
    error = Error(0.2, 0.005, 0.3, "N m")
    (section,) = proposed_sections(Diagnosis("unexplained", error, (), None, proposals=(row,)))
    assert section.next_step == 'edge-daemon add NAME --expression "a*velocity_out_rad_s"'
    assert "1.00%" in section.verdict and "20.00%" in section.verdict and "viscous_friction" in section.verdict
    assert isinstance(section.content, Figure)
    assert [mark.label for mark in section.content.marks] == ["seen", "formula"]  # type: ignore[union-attr]

"""What comparing and diagnosing found, as the few plots that tell: each with a verdict and a next step."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

import numpy as np

from edge_daemon import __version__
from edge_daemon.explain.interpretation import (
    AXES,
    PARAMETER_HEAD,
    SHOWN_S,
    adequate,
    filled,
    is_guess,
    parameter_cells,
    times_noise,
)
from edge_daemon.explain.results import Candidate, Comparison, Diagnosis, OrderSpectrum, Proposal, Series, none_of
from edge_daemon.records import Array
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
)
from edge_daemon.text import number, with_sd

AXES_SHOWN = 3
STANDS_OUT = 6.0
"""The highest of thousands of noise amplitudes is some 3.5 times their median (Rayleigh): a line is well above."""
PROPOSALS_SHOWN = 3


def of_comparison(result: Comparison, title: str) -> str:
    """The page of one comparison."""
    good = adequate(result.error)
    step = "" if good else "edge-daemon diagnose names what is missing"
    verdict = "The model is as good as the sensors can tell." if good else _misses(result)
    first = FirstPage(verdict, step, list(_facts(result)), _growth(result))
    return render_report(title, _lead(result), list(_compared(result, step)), first)


def of_diagnosis(diagnosis: Diagnosis, result: Comparison, title: str) -> str:
    """The page of a diagnosis, the comparison it began from included."""
    diagnosed = list(diagnosed_sections(diagnosis))
    verdict = diagnosed[0].verdict if diagnosis.verdict == "adequate" else f"{_misses(result)} {diagnosed[0].verdict}"
    first = FirstPage(verdict, diagnosed[0].next_step, list(_facts(result)), _growth(result))
    sections = [*diagnosed, *proposed_sections(diagnosis), *_compared(result, "")]
    return render_report(title, _lead(result), sections, first)


def _misses(result: Comparison) -> str:
    error = result.error
    return (
        f"The model misses {error.nrmse:.1%} of what was measured, {number(times_noise(error), 2)} times sensor noise."
    )


def _facts(result: Comparison) -> Iterator[tuple[str, str]]:
    """Of what, from when, how much of it."""
    yield "date", f"{datetime.now(UTC):%Y-%m-%d}"
    if result.series is not None and len(result.series.time_s) > 1:
        time_s = result.series.time_s
        yield "duration", f"{float(time_s[-1] - time_s[0]):.4g} s"
        yield "rate", f"{1.0 / float(np.median(np.diff(time_s))):.4g} Hz, as compared"
    yield "model", ", ".join(effect.name for effect in result.model.effects)
    versions = result.model.lineage
    for before, after in itertools.pairwise(versions):
        yield after.change, f"held-out error {before.nrmse:.2%} to {after.nrmse:.2%}"
    known = [row for row in result.parameters if row.identified]
    yield "known", ", ".join(f"{row.effect} {row.name} {with_sd(row.value, row.sd)} {row.unit}" for row in known[:4])
    yield "tool", f"edge-daemon {__version__}"


def _growth(result: Comparison) -> Figure | None:
    """Before and after in one plot, where the model has grown."""
    versions = result.model.lineage
    if len(versions) < 2:
        return None
    ends = [100 * versions[0].nrmse, 100 * versions[-1].nrmse]
    bars = Bars(["before", "after"], ends, [f"{end:.3g} %" for end in ends])
    return Figure("held-out error [%]", "", [bars])


def _lead(result: Comparison) -> str:
    error = result.error
    effects = ", ".join(effect.name for effect in result.model.effects)
    return (
        f"On blocks it was not fitted to, the model ({effects}) is wrong by {error.nrmse:.2%} of the measured rms "
        f"({error.rmse:.3g} {error.unit}); sensor noise alone would make {error.noise_floor_nrmse:.2%}: "
        f"{number(times_noise(error), 3)} times that."
    )


def diagnosed_sections(diagnosis: Diagnosis) -> Iterator[ReportSection]:
    rows = diagnosis.candidates[:6]
    verdicts = {
        "adequate": "No effect would explain what is left.",
        "unexplained": "Structure is left that no effect of the catalogue removes.",
        "missing": missing_sentence(rows[0]) if rows else "",
    }
    step = {
        "adequate": "keep the model; compare again when the motion, load or temperature changes",
        "unexplained": "a formula is proposed below"
        if diagnosis.proposals
        else "look at the axes below and try a formula of your own",
        "missing": f"edge-daemon add {rows[0].effect}" if rows else "",
    }[diagnosis.verdict]
    if diagnosis.next_experiment:
        plan = diagnosis.next_experiment
        step += f"; to tell {' from '.join(plan.separates)}: {plan.motion}"
    content = None
    if rows:
        texts = [f"{row.nrmse_after:.2%}, {_belief(row.probability)}{_alike(row.confused_with)}" for row in rows]
        texts.append(_belief(none_of(diagnosis.candidates)))
        names, error = [row.effect for row in rows], diagnosis.error.nrmse
        lengths = [*(100 * row.nrmse_after for row in rows), 100 * error]
        bars = Bars([*names, "none of them"], lengths, texts, [*_intervals(rows), (100 * error, 100 * error)])
        content = Figure(f"held-out error with it [%] (without: {100 * diagnosis.error.nrmse:.3g} %)", "", [bars])
    yield ReportSection("Which effect is missing", verdicts[diagnosis.verdict], step, content)


def _belief(probability: float) -> str:
    return f"p = {probability:.2f}" if probability >= 0.005 else "p < 0.01"


def proposed_sections(diagnosis: Diagnosis) -> Iterator[ReportSection]:
    """The formulas, each with the curve that was seen beside it."""
    for row in diagnosis.proposals[:PROPOSALS_SHOWN]:
        seen = ", ".join(f"{axis} {low:.3g} to {high:.3g}" for axis, (low, high) in row.range.items())
        like = f" Of the catalogue it is nearest to {row.resembles}." if row.resembles else ""
        verdict = (
            f"{row.expression}: {row.reads}. With it the held-out error is {row.nrmse_after:.2%} instead of "
            f"{diagnosis.error.nrmse:.2%}; probability {row.probability:.2f}. Seen over {seen}.{like}"
        )
        step = f'edge-daemon add NAME --expression "{row.expression}"'
        yield ReportSection("A law outside the catalogue", verdict, step, _curve(row, diagnosis.error.unit))


def _curve(row: Proposal, unit: str) -> Figure | None:
    if row.curve is None:
        return None
    curve = row.curve
    marks: list[Cloud | Line] = [Cloud(curve.at, curve.seen, "seen"), Line(curve.at, curve.formula, "formula")]
    return Figure(curve.axis, f"torque, at the rms of the other factors [{unit}]", marks)


def missing_sentence(best: Candidate) -> str:
    if not is_guess(best):
        return f"Missing: {best.effect}."
    return (
        f"Something is missing. {best.effect} leaves the least error, but at a probability of {best.probability:.2f} "
        "it is no more than a guess."
    )


def _intervals(rows: Sequence[Candidate]) -> list[tuple[float, float]]:
    """(low, high) of each held-out error [%], two standard deviations to either side."""
    known = [0.0 if np.isnan(row.nrmse_after_sd) else row.nrmse_after_sd for row in rows]
    return [
        (100 * max(row.nrmse_after - 2 * sd, 0.0), 100 * (row.nrmse_after + 2 * sd))
        for row, sd in zip(rows, known, strict=True)
    ]


def _alike(names: tuple[str, ...]) -> str:
    return f"\nor {', '.join(names)}" if names else ""


def _quantity(unit: str) -> str:
    """What is compared; a drive without a torque signal compares its motor current."""
    return f"motor current [{unit}]" if unit == "A" else f"torque [{unit}]"


def _compared(result: Comparison, step: str) -> Iterator[ReportSection]:
    series, unit = result.series, result.error.unit
    if series is not None and len(series.time_s):
        yield _side_by_side(series, unit, result.error.nrmse, step)
        for row in [row for row in result.where if row.axis in AXES][:AXES_SHOWN]:
            verdict = f"{row.share:.0%} of the residual's variance depends on the {row.axis}: {row.detail}."
            yield ReportSection(f"Residual against {row.axis}", verdict, step, _against(series, row.axis, unit))
        if np.nan_to_num(series.twist_rad).any():  # none with one encoder
            yield _loop(series, unit)
    for spectrum in result.spectra:
        yield spectrum_section(spectrum, unit, adequate(result.error))
    yield _parameters(result)
    if len(result.model.lineage) > 1:
        yield _lineage(result)


def _side_by_side(series: Series, unit: str, nrmse: float, step: str) -> ReportSection:
    inside = series.time_s - series.time_s[0] < SHOWN_S
    columns = (series.torque[inside], series.modelled[inside], series.residual[inside])
    time_s, measured, modelled, residual = broken(series.time_s[inside], *columns)
    lines = [
        Line(time_s, measured, "measured"),
        Line(time_s, modelled, "modelled"),
        Line(time_s, residual, "residual", thin=True),
    ]
    verdict = f"The model misses {nrmse:.2%} of the measured rms over the whole recording."
    return ReportSection("Measured and modelled", verdict, step, Figure("time [s]", _quantity(unit), lines))


def _against(series: Series, axis: str, unit: str) -> Figure:
    row = AXES[axis]
    at: Array = np.asarray(getattr(series, row.field))
    at = at % row.period if row.period else at
    bins = filled(at)
    centres, means = (np.array([values[part].mean() for part in bins]) for values in (at, series.residual))
    every = max(1, len(at) // 3000)
    marks: list[Cloud | Line] = [Cloud(at[::every], series.residual[::every], "samples"), Line(centres, means, "mean")]
    name = f"{row.meaning} [{row.unit}]" if row.unit else f"measured {_quantity(unit)}"
    return Figure(name, f"residual [{unit}]", marks)


def _loop(series: Series, unit: str) -> ReportSection:
    inside = series.time_s - series.time_s[0] < SHOWN_S
    columns = (series.twist_rad[inside], series.torque[inside], series.modelled[inside])
    _, twist_rad, measured, modelled = broken(series.time_s[inside], *columns)
    lines = [Line(twist_rad, measured, "measured", thin=True), Line(twist_rad, modelled, "modelled", thin=True)]
    verdict = "The slope is the stiffness; the width of the measured loop is what the gear loses in a cycle."
    step = "a loop wider than the modelled one asks for friction or hysteresis, a bent one for a stiffness that changes"
    return ReportSection("Torque over twist", verdict, step, Figure("twist [rad]", _quantity(unit), lines))


def spectrum_section(spectrum: OrderSpectrum, unit: str, good: bool) -> ReportSection:
    """What the residual is largest at, and what that may be; causes are named only above the noise."""
    peak = int(np.argmax(spectrum.amplitude)) if len(spectrum.amplitude) else 0
    kinds = {
        "frequency": ("frequency [Hz]", "Hz", "a resonance or an outside torque"),
        "input order": ("order, per turn of the wave generator", "per input turn", "kinematic error or ripple"),
        "output order": ("order, per turn of the output", "per output turn", "eccentricity, gravity or a tooth"),
    }
    name, word, meaning = kinds.get(spectrum.axis, (spectrum.axis, "", "structure"))
    verdict = f"The residual is largest at {spectrum.at[peak]:.3g} {word}" if len(spectrum.at) else "No spectrum."
    stands_out = len(spectrum.at) > 0 and spectrum.amplitude[peak] > STANDS_OUT * np.median(spectrum.amplitude)
    caused = stands_out and not good
    verdict += f": {meaning} would look like this." if caused else ", but at the level of the noise around it."
    figure = Figure(name, f"residual amplitude [{unit}]", [Line(spectrum.at, spectrum.amplitude)], log_y=True)
    return ReportSection(f"Spectrum of the residual: {spectrum.axis}", verdict, "", figure)


def _parameters(result: Comparison) -> ReportSection:
    lost = [f"{row.effect} {row.name}" for row in result.parameters if not row.identified]
    verdict = "Every parameter is identified." if not lost else f"Not identified: {', '.join(lost)}."
    step = "" if not lost else "see the last column for what would identify them"
    return ReportSection("Parameters", verdict, step, ReportTable(PARAMETER_HEAD, parameter_cells(result.parameters)))


def _lineage(result: Comparison) -> ReportSection:
    versions = result.model.lineage
    errors = [100 * version.nrmse for version in versions]
    bars = Bars([version.change for version in versions], errors, [f"{error:.3g} %" for error in errors])
    steps = "one step" if len(versions) == 2 else f"{len(versions) - 1} steps"
    moved = "fell" if errors[-1] < errors[0] else "rose"
    verdict = f"The error {moved} from {errors[0]:.3g} % to {errors[-1]:.3g} % in {steps}."
    return ReportSection("How the model grew", verdict, "", Figure("held-out error [%]", "", [bars], log_x=True))

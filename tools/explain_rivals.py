"""Two published methods on the library of physics that diagnosis searches: how often they name the hidden effect.

    python tools/explain_rivals.py [SEEDS] [--bits 24 20]

PySINDy (its own STLSQ: Brunton, Proctor & Kutz 2016, PNAS 113(15), algorithm 1), the threshold chosen by held-out
error. SysIdentPy 0.9 demands numpy < 2.4, which this product does not run on; its method, forward regression with
orthogonal least squares (FROLS: Billings 2013, Nonlinear System Identification, section 3.2) stopped by BIC or AICc, is
written out below. Both get every column that diagnosis starts from, behind the same filter, at every point of the
grids of shapes. Neither can say `unexplained`: the effects outside the catalogue are left out for all.
"""

from __future__ import annotations

import argparse
import math
import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from bench_explain import PARTNERS, Case, base_model, cases, judge
from bench_row import HEAD, Row, cells
from numpy.typing import NDArray
from pysindy import STLSQ

from edge_daemon.explain.diagnose import diagnose, missing_effects
from edge_daemon.identify.fit import fit_terms
from edge_daemon.identify.problem import problem_of, terms_of
from edge_daemon.rig.recording import Simulated
from edge_daemon.search.grid_fit import grid
from edge_daemon.text import table

Array = NDArray[np.float64]

THRESHOLDS = np.geomspace(3e-3, 0.9, 12)
"""of a coefficient, column and what is left of the torque at unit rms"""
RIDGES = (1e-6, 1e-3, 0.05)
"""penalties of PySINDy's ridge regression, up to its own default: nearly equal columns cancel each other without"""
MOST_TERMS = 8
"""columns that forward regression may add: the largest true pair has fewer"""
LEAST_LEFT = 1e-6
"""share of a column left after orthogonalisation below which it repeats what was chosen"""


@dataclass(frozen=True, slots=True)
class Library:
    """Every candidate column and the torque, without what the base model explains of them, then at unit rms: so that
    no method has to find the spring again and a threshold is a share of what is left."""

    columns: Array
    target: Array
    owner: tuple[str, ...]
    """effect of each column"""
    fold: NDArray[np.intp]
    """hold-out fold of each row"""

    def names(self, chosen: Sequence[int]) -> list[str]:
        """The effects that the chosen columns add to the base model, in the order of the columns."""
        return list(dict.fromkeys(self.owner[i] for i in chosen))


Method = Callable[[Library], list[str]]
"""the effects that a method adds, the weightiest first"""


def library_of(recording: Simulated) -> Library:
    """The columns that diagnosis would start from, tied shapes at the base fit's values."""
    model = base_model(recording)
    bench = problem_of([recording], model)
    base = fit_terms(bench, terms_of(model, bench))
    parts, owner = [], []
    for effect in missing_effects(model, bench):
        for shapes in grid(effect, bench):
            columns = bench.columns(effect, shapes)
            parts.append(columns)
            owner += [effect.name] * columns.shape[1]
    every = np.column_stack([*parts, bench.target])
    q, _ = np.linalg.qr(base.columns)
    left = every - q @ (q.T @ every)
    rms, before = np.sqrt(np.mean(left**2, axis=0)), np.sqrt(np.mean(every**2, axis=0))
    kept = np.isfinite(rms) & (rms > math.sqrt(LEAST_LEFT) * before)
    kept[-1] = False
    owners = tuple(name for name, good in zip(owner, kept[:-1], strict=True) if good)
    return Library(left[:, kept] / rms[kept], left[:, -1] / rms[-1], owners, bench.fold[bench.block])


def pysindy_stlsq(library: Library) -> list[str]:
    """PySINDy's answer: ridge and threshold by held-out error, of the thresholds the sparsest within one standard error
    of the best (Breiman et al. 1984)."""
    tried = [(errors_of(library, ridge), ridge) for ridge in RIDGES]
    errors, ridge = min(tried, key=lambda pair: float(pair[0].mean(axis=1).min()))
    mean, spread = errors.mean(axis=1), errors.std(axis=1, ddof=1) / math.sqrt(errors.shape[1])
    best = int(np.argmin(mean))
    last = int(np.flatnonzero(mean <= mean[best] + spread[best])[-1])
    weights = stlsq(*compressed(library.columns, library.target), THRESHOLDS[last], ridge)
    order = np.argsort(-np.abs(weights))
    return library.names([int(i) for i in order if weights[i] != 0])


def errors_of(library: Library, ridge: float) -> Array:
    """(thresholds, folds) mean square error on each fold of a fit to the others."""
    folds = np.unique(library.fold)
    out = np.empty((len(THRESHOLDS), len(folds)))
    for j, fold in enumerate(folds):
        seen = library.fold != fold
        known = compressed(library.columns[seen], library.target[seen])
        for i, threshold in enumerate(THRESHOLDS):
            miss = library.target[~seen] - library.columns[~seen] @ stlsq(*known, threshold, ridge)
            out[i, j] = float(np.mean(miss**2))
    return out


def compressed(columns: Array, target: Array) -> tuple[Array, Array]:
    """(p, p) and (p,) with the normal equations of the (m, p) and (m,) given, per row: the same answer, sooner."""
    q, r = np.linalg.qr(columns)
    scale = 1 / math.sqrt(len(target))
    return np.asarray(r * scale), np.asarray((q.T @ target) * scale)


def stlsq(columns: Array, target: Array, threshold: float, ridge: float) -> Array:
    """(p,) PySINDy's coefficients; none where it eliminates every column."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of each elimination of all terms and each singular set
        optimizer = STLSQ(threshold=float(threshold), alpha=ridge, max_iter=50)
        optimizer.fit(columns, target[:, None])
    return np.asarray(optimizer.coef_, dtype=float).ravel()


def frols_bic(library: Library) -> list[str]:
    """FROLS stopped where BIC is least."""
    return frols(library, lambda rows, terms: terms * math.log(rows))


def frols_aicc(library: Library) -> list[str]:
    """FROLS stopped where the corrected Akaike criterion is least."""
    return frols(library, lambda rows, terms: 2 * terms * rows / (rows - terms - 1))


def frols(library: Library, penalty: Callable[[int, int], float]) -> list[str]:
    """Columns by falling error reduction ratio onto the base model, as many as the criterion allows."""
    rows = len(library.target)
    chosen, left = forward(library.columns, library.target)
    scores = [rows * math.log(error) + penalty(rows, terms) for terms, error in enumerate(left)]
    return library.names(chosen[: int(np.argmin(scores))])


def forward(columns: Array, target: Array) -> tuple[list[int], list[float]]:
    """The columns in the order of their error reduction ratio, and the mean square error left by 0, 1, ... of them."""
    left, rest = columns.copy(), target.copy()
    power = np.sum(left**2, axis=0)
    chosen: list[int] = []
    errors = [float(np.mean(rest**2))]
    for _ in range(MOST_TERMS):
        own = np.sum(left**2, axis=0)
        free = own > LEAST_LEFT * power
        ratio = np.where(free, (rest @ left) ** 2 / np.where(free, own, 1.0), -1.0)
        pick = int(np.argmax(ratio))
        direction = left[:, pick] / np.linalg.norm(left[:, pick])
        rest = rest - direction * (direction @ rest)
        left = left - np.outer(direction, direction @ left)
        left[:, pick] = 0.0
        chosen.append(pick)
        errors.append(float(np.mean(rest**2)))
    return chosen, errors


def frols_held_out(library: Library) -> list[str]:
    """FROLS stopped by held-out error, the shortest within one standard error of the best: kinder than its own."""
    chosen, _ = forward(library.columns, library.target)
    folds = np.unique(library.fold)
    errors = np.empty((len(chosen) + 1, len(folds)))
    for count in range(len(chosen) + 1):
        columns = library.columns[:, chosen[:count]]
        for j, fold in enumerate(folds):
            seen = library.fold != fold
            weights = np.linalg.lstsq(columns[seen], library.target[seen], rcond=None)[0]
            errors[count, j] = float(np.mean((library.target[~seen] - columns[~seen] @ weights) ** 2))
    mean, spread = errors.mean(axis=1), errors.std(axis=1, ddof=1) / math.sqrt(len(folds))
    best = int(np.argmin(mean))
    return library.names(chosen[: int(np.flatnonzero(mean <= mean[best] + spread[best])[0])])


METHODS: dict[str, Method] = {
    "PySINDy STLSQ": pysindy_stlsq,
    "FROLS + BIC": frols_bic,
    "FROLS + AICc": frols_aicc,
    "FROLS + held-out": frols_held_out,
}
OURS = "diagnose"


@dataclass(frozen=True, slots=True)
class Answer:
    """What one method said of one recording."""

    method: str
    case: Case
    said: tuple[str, ...]
    """effects added, the weightiest first"""
    first: bool
    """whether the true effects, under any such name, come first, whatever else is named behind them"""
    exact: bool
    right: bool
    """exact, or the same with other names for one function of the motion"""
    seconds: float


def answers(case: Case) -> list[Answer]:
    """Every method on one recording; ours judged as in its own table, and as the rivals by the exact set."""
    recording = case.recording()
    truth = [str(name) for name in recording.truth["effects"]]  # type: ignore[attr-defined]
    start = time.perf_counter()
    diagnosis = diagnose([recording], base_model(recording))
    judgement = judge(case, truth, diagnosis)
    named = diagnosis.candidates[0].effect.split("+") if diagnosis.verdict == "missing" else []
    out = [answer_of(OURS, case, named, truth, judgement.right, time.perf_counter() - start)]
    start = time.perf_counter()
    library = library_of(recording)
    built = time.perf_counter() - start
    for name, method in METHODS.items():
        start = time.perf_counter()
        named = method(library)
        seconds = built + time.perf_counter() - start
        out.append(answer_of(name, case, named, truth, False, seconds))
    return out


def answer_of(
    method: str, case: Case, named: Sequence[str], truth: Sequence[str], right: bool, seconds: float
) -> Answer:
    """An answer with its marks."""
    exact = set(named) == set(truth)
    known, wanted = list(dict.fromkeys(map(alike, named))), {alike(name) for name in truth}
    first = set(known[: len(wanted)]) == wanted
    return Answer(method, case, tuple(named), first, exact, right or set(known) == wanted, seconds)


def alike(name: str) -> str:
    """One name for effects that are one function of the motion: rivals cannot list them, nor lose by naming two."""
    return next((min(group) for group in PARTNERS if name in group), name)


def share(found: Sequence[Answer], what: Callable[[Answer], bool]) -> float:
    """Of the answers, how many; NaN for none."""
    return sum(map(what, found)) / len(found) if found else math.nan


def rows_of(found: Sequence[Answer]) -> list[Row]:
    """Ours with the rivals beside it: success, exact sets, false alarms, time."""
    bits = sorted({answer.case.bits_out for answer in found}, reverse=True)
    out = []
    for bit in bits:
        for healthy in (False, True):
            chosen = [a for a in found if a.case.bits_out == bit and bool(a.case.effects) is not healthy]
            for title, unit, value in HEALTHY if healthy else HIDDEN:
                figures = {name: value([a for a in chosen if a.method == name]) for name in (OURS, *METHODS)}
                peer = ", ".join(f"{name} {figures[name]:.3g}" for name in METHODS)
                count = sum(a.method == OURS for a in chosen)
                out.append(Row(f"{title}, rich, {bit} bits, {count} records", figures[OURS], unit, peer=peer))
    return out


Figure = Callable[[Sequence[Answer]], float]
HIDDEN: tuple[tuple[str, str, Figure], ...] = (
    ("exact set", "1", lambda found: share(found, lambda a: a.exact)),
    ("true effects first", "1", lambda found: share(found, lambda a: a.first)),
    ("exact or equivalent set", "1", lambda found: share(found, lambda a: a.right)),
    ("time a record", "s", lambda found: float(np.median([a.seconds for a in found])) if found else math.nan),
)
HEALTHY: tuple[tuple[str, str, Figure], ...] = (
    ("false alarms on healthy", "1", lambda found: share(found, lambda a: bool(a.said))),
)


def rows(seeds: int = 1, bits: Sequence[int] = (24, 20), names: Sequence[str] = ()) -> list[Row]:
    """The comparison on rich motion, every case `seeds` times."""
    chosen = [case for case in cases(seeds, bits, ("rich",), names) if case.effects != ("outside",)]
    return rows_of([answer for case in chosen for answer in answers(case)])


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", type=int, nargs="?", default=1)
    parser.add_argument("--bits", type=int, nargs="+", default=[24, 20])
    parser.add_argument("--case", nargs="+", default=[])
    given = parser.parse_args()
    print(table(HEAD, map(cells, rows(given.seeds, given.bits, given.case))))


if __name__ == "__main__":
    main()

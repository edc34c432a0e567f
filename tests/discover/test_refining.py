"""Formulas on their way to rest, where what they say is the model's already."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from edge_daemon.discover.factors import KINDS, Factor, Product
from edge_daemon.discover.refining import Formula, settled

ROWS = 60
PRODUCT = Product((Factor(KINDS["bump"], "place", (0.4, 0.2)), Factor(KINDS["exponential"], "heat", (0.3,))))


def test_numbers_that_change_nothing_but_by_rounding_stay() -> None:
    """All that these columns change is what the model's own would take: a robot's joint ended in a singular matrix."""
    for seed in range(300):
        formula = at_rest(np.random.default_rng(seed))
        assert formula is not None and np.isfinite(formula.square)
        assert np.isfinite(formula.products[0].numbers).all()


def at_rest(rng: np.random.Generator) -> Formula | None:
    """Where the product ends beside a model that takes all that its numbers change."""
    known = np.linalg.qr(rng.normal(size=(ROWS, 4)))[0]
    mine, left = rng.normal(size=ROWS), rng.normal(size=ROWS)

    def columns(*products: Product, mixes: object = ()) -> np.ndarray:
        moved = 3e-5 * known @ rng.normal(size=(4, len(products)))
        return mine[:, None] + moved if mixes else np.repeat(mine[:, None], len(products), axis=1)

    spans = dict.fromkeys(("place", "heat"), SimpleNamespace(width=1.0))
    leftover = SimpleNamespace(columns=columns, known=known, left=left - known @ (known.T @ left), spans=spans)
    return settled(leftover, [PRODUCT], 3)  # type: ignore[arg-type]

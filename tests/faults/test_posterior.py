"""Which fault the drifts point to, with few sensors and with many, and where no row of the table fits."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.faults.conditions import KNOWN
from edge_daemon.faults.posterior import NONE, UNKNOWN, Drifts, posterior
from edge_daemon.faults.table import FAULTS, GearFault

FEW = ("stiffness", "damping", "coulomb_friction")
SOUND = tuple(name for name in KNOWN if name.startswith("noise_"))


def drifts_of(fault: GearFault, severity: float, names: tuple[str, ...] = tuple(KNOWN), seed: int = 0) -> Drifts:
    """What a fault of this severity shows, each condition straying by a fifth of its sign."""
    rng = np.random.default_rng((seed, FAULTS.index(fault)))
    told = {name: severity * fault.signs.get(name, 0.0) * (1.0 + 0.2 * rng.normal()) for name in names}
    return {name: (drift + 0.1 * rng.normal(), 0.1) for name, drift in told.items()}


def test_every_row_names_conditions_that_are_watched() -> None:
    for row in FAULTS:
        assert set(row.signs) <= set(KNOWN), row.name
        assert row.source and row.advice


@pytest.mark.parametrize("fault", FAULTS, ids=lambda row: row.name)
def test_a_plain_fault_with_all_sensors_is_named(fault: GearFault) -> None:
    told = posterior(drifts_of(fault, 5.0))
    assert told.named == fault.kind
    assert told.finest == fault.name
    assert sum(told.rows.values()) == pytest.approx(1.0)
    assert sum(told.kinds.values()) == pytest.approx(1.0)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda row: row.name)
def test_absent_sensors_never_rule_the_true_fault_out(fault: GearFault) -> None:
    few = posterior(drifts_of(fault, 5.0, FEW))
    wrong = max((kind for kind in few.kinds if kind != fault.kind), key=lambda kind: few.kinds[kind])
    assert few.kinds[fault.kind] > 0.005 or wrong == NONE


@pytest.mark.parametrize("names", [tuple(KNOWN), FEW, SOUND], ids=["all", "few", "sound"])
def test_what_is_left_open_holds_the_true_kind(names: tuple[str, ...]) -> None:
    """Also of faults too slight for these sensors, which no gear's chance of being well may hide."""
    found = [
        (fault.kind, posterior(drifts_of(fault, severity, names, seed)).possible)
        for fault in FAULTS
        for severity in (0.7, 2.0, 6.0)
        for seed in range(3)
    ]
    assert np.mean([kind in possible for kind, possible in found]) >= 0.85
    if len(names) == len(KNOWN):
        assert np.mean([len(possible) for _, possible in found]) < 2.0


def test_nothing_measured_leaves_everything_open() -> None:
    told = posterior({})
    assert set(told.possible) == set(told.kinds)
    still = posterior(dict.fromkeys(KNOWN, (0.0, 0.05)))
    assert still.possible[0] == NONE
    assert len(still.possible) < len(told.possible)


def test_nothing_measured_says_what_was_believed_before() -> None:
    told = posterior({})
    assert told.rows[NONE] == pytest.approx(0.9)
    assert told.named == NONE


def test_small_drifts_are_no_fault() -> None:
    rng = np.random.default_rng(3)
    assert posterior({name: (0.3 * rng.normal(), 0.3) for name in KNOWN}).named == NONE


def test_a_drift_along_no_fault_is_unknown() -> None:
    still = dict.fromkeys(KNOWN, (0.0, 0.1))
    assert posterior({**still, "ratio": (8.0, 0.1)}).named == UNKNOWN
    assert posterior({**still, "stiffness": (8.0, 0.1), "noise_a4": (-6.0, 0.1)}).named == UNKNOWN
    assert "fits no known fault" in posterior({**still, "ratio": (8.0, 0.1)}).given_a_fault().in_words()


def test_the_sign_counts() -> None:
    softer, stiffer = ({**dict.fromkeys(FEW, (0.0, 0.1)), "stiffness": (size, 0.1)} for size in (-5.0, 5.0))
    fatigue = [posterior(drift).given_a_fault().kinds["flexspline fatigue"] for drift in (softer, stiffer)]
    assert fatigue[0] > 0.2 > 0.02 > fatigue[1]

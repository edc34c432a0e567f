"""Which drives differ from their peers under the same load, and which of them differ alike.

Each number is compared in its logarithm after what load, speed and temperature explain has been taken out over the
fleet (Huber's robust regression, 1964). How far peers scatter is told from the quiet side of them, where those that
differ do not stand; errors are held to a false discovery rate (Benjamini and Hochberg 1995) over drives and numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.stats import t as student

from edge_daemon.errors import BadInput
from edge_daemon.fleet.past import DrivePast, only, pasts
from edge_daemon.records import Array, Mask

COMPARED = (
    *("model_error", "damping", "coulomb_friction", "kinematic_error", "hysteresis_area"),
    *("stribeck_speed", "hysteresis_width", "half_gap", "encoder_skew"),
)
"""The model's error above its noise floor, and the amplitudes of effects."""
MODEL_ERROR = "model_error"
LOADS = ("torque_rms", "speed_in", "temperature")
RATE = 0.05
"""So large a share of the drives that are named may be named wrongly."""
FEWEST = 8
"""Fewer peers do not tell what is usual."""
LEAST_SD = 0.01
"""Numbers of drives differ by a hundredth whatever the fleet's scatter says (guess): less is no difference."""
LEAST_Z = 3.5
"""Whatever the rate allows, nothing nearer than this to the peers is named: a drive in four thousand of any fleet."""
ALIKE = 0.7
"""Drives whose deviations have this cosine or more differ alike (guess)."""
DOUBTED = 1.5
"""Tails count as heavy only beyond what chance gives so many samples: this over their root (two standard errors)."""
HUBER = 1.345
"""Huber's constant: 95 % efficient where errors are normal."""
ROUNDS = 30


@dataclass(frozen=True, slots=True)
class Deviation:
    """How one number of one drive stands to its peers."""

    name: str
    value: float
    expected: float
    """of a peer under this load"""
    z: float
    q: float
    """false discovery rate at which it would just be named"""

    def to_json(self) -> dict[str, Any]:
        return {"name": self.name, "value": self.value, "expected": self.expected, "z": self.z, "q": self.q}


@dataclass(frozen=True, slots=True)
class Peers:
    """What the comparison found."""

    drives: int
    units: Mapping[str, tuple[Deviation, ...]]
    """drive -> what differs, largest first"""
    groups: tuple[tuple[str, ...], ...]
    """drives that differ alike, largest group first; each drive stands once"""

    def to_json(self) -> dict[str, Any]:
        return {
            "drives": self.drives,
            "false_discovery_rate": RATE,
            "units": [_unit(drive, rows) for drive, rows in self.units.items()],
            "groups": [self._group(group) for group in self.groups],
        }

    def _group(self, group: tuple[str, ...]) -> dict[str, Any]:
        return {"drives": list(group), "count": len(group), "what": self.said(group), "names": list(self.shared(group))}

    def shared(self, group: Sequence[str]) -> Iterator[str]:
        """Numbers in which at least half of a group differs."""
        for name in COMPARED:
            if 2 * sum(any(row.name == name for row in self.units[drive]) for drive in group) >= len(group):
                yield name

    def said(self, group: Sequence[str]) -> str:
        """In words."""
        names, many = list(self.shared(group)), len(group) > 1
        some = f"these {len(group)} drives" if many else "this drive"
        others = [name for name in names if name != MODEL_ERROR]
        if MODEL_ERROR in names:
            beside = f"; {', '.join(others)} differ too" if others else ""
            return f"{some} {'share' if many else 'has'} a missing effect: the model errs more than a peer's{beside}"
        return f"{some} {'differ' if many else 'differs'} from peers in {', '.join(others) or 'several numbers'}"


def _unit(drive: str, rows: Sequence[Deviation]) -> dict[str, Any]:
    site, gateway, name = drive.split("/")
    return {"site": site, "gateway": gateway, "drive": name, "differs": [row.to_json() for row in rows]}


def compared_dataset(folder: Path, gear: str | None, scheduler: str | None) -> Peers:
    """The drives of a dataset beside each other, those with one gear where it is named. Raises `BadInput`."""
    drives = pasts(folder, scheduler)
    drives = only(drives, gear) if gear else drives
    if len(drives) < FEWEST:
        raise BadInput(f"{folder}: {len(drives)} drives: expected at least {FEWEST} to compare")
    return compared(drives)


def compared(drives: Sequence[DrivePast]) -> Peers:
    """Drives of one kind beside each other."""
    loads = np.array([[_positive(past.mean(name), name) for name in LOADS] for past in drives]).reshape(len(drives), -1)
    names, values, expected, z, p = [], [], [], [], []
    for name in COMPARED:
        x = np.array([_log_of(past, name) for past in drives])
        if np.isfinite(x).sum() < FEWEST:
            continue
        usual = _usual(x, loads)
        far, chance = _far(x - usual)
        names.append(name)
        values.append(x)
        expected.append(usual)
        z.append(far)
        p.append(chance)
    if not names:
        return Peers(len(drives), {}, ())
    z_all, p_all = np.array(z), np.array(p)
    q = _discovery(p_all)
    found: dict[str, tuple[Deviation, ...]] = {}
    for at, past in enumerate(drives):
        rows = [
            Deviation(
                names[k], math.exp(values[k][at]), math.exp(expected[k][at]), float(z_all[k, at]), float(q[k, at])
            )
            for k in range(len(names))
            if q[k, at] <= RATE and abs(z_all[k, at]) >= LEAST_Z
        ]
        if rows:
            found[past.drive] = tuple(sorted(rows, key=lambda row: -abs(row.z)))
    index = {past.drive: at for at, past in enumerate(drives)}
    signatures = np.array([np.nan_to_num(z_all[:, index[drive]]) for drive in found]).reshape(len(found), len(names))
    signatures[np.abs(signatures) < LEAST_Z] = 0.0
    return Peers(len(drives), found, _groups(list(found), signatures))


def _positive(value: float, name: str) -> float:
    """Logarithm of a load; a temperature as it is, in tens of kelvins."""
    if name == "temperature":
        return value / 10.0
    return math.log(abs(value)) if math.isfinite(value) and value != 0.0 else math.nan


def _log_of(past: DrivePast, name: str) -> float:
    """Logarithm of a number's size; the model's error is what stands above the noise floor."""
    value = past.mean(name)
    if name == MODEL_ERROR:
        error, floor = past.mean("model_nrmse"), past.mean("model_noise_floor")
        value = math.sqrt(max(error**2 - floor**2, (0.1 * error) ** 2)) if math.isfinite(floor) else error
    return math.log(abs(value)) if math.isfinite(value) and value != 0.0 else math.nan


def _usual(x: Array, loads: Array) -> Array:
    """(n,) what a peer under the same load would have."""
    known = np.isfinite(x)
    columns = [np.ones(len(x))]
    for load in loads.T:
        filled = np.where(
            np.isfinite(load), load, np.median(load[np.isfinite(load)]) if np.isfinite(load).any() else 0.0
        )
        if np.ptp(filled) > 1e-6 and known.sum() > 4 * (len(columns) + 1):
            columns.append(filled - np.median(filled))
    design = np.column_stack(columns)
    weight = known.astype(float)
    target = np.where(known, x, 0.0)
    best = np.zeros(design.shape[1])
    best[0] = np.median(x[known])
    for _ in range(ROUNDS):
        off = target - design @ best
        sd = max(1.4826 * float(np.median(np.abs(off[known]))), LEAST_SD)
        weight = known * np.minimum(1.0, HUBER * sd / np.maximum(np.abs(off), 1e-12))
        normal = design.T @ (weight[:, None] * design) + 1e-9 * np.eye(design.shape[1])
        best = np.linalg.solve(normal, design.T @ (weight * target))
    return np.asarray(design @ best)


def _far(off: Array) -> tuple[Array, Array]:
    """(n,) robust deviations and their chances among peers, each side judged by how the other one scatters."""
    known = np.isfinite(off)
    middle = float(np.median(off[known]))
    z, p = np.full(len(off), np.nan), np.ones(len(off))
    for sign in (1.0, -1.0):
        quiet = np.sort(sign * (middle - off[known]))
        quiet = quiet[quiet >= 0.0]
        sd = max(1.4826 * float(np.median(quiet)), LEAST_SD)
        freedom = _freedom(quiet / sd)
        side: Mask = known & (sign * (off - middle) >= 0.0)
        z[side] = (off[side] - middle) / sd
        p[side] = 2.0 * student.sf(np.abs(z[side]), freedom)
    return z, p


def _freedom(quiet: Array) -> float:
    """Degrees of freedom of Student's law with these tails: half-scatters in units of their robust sd."""
    outer = float(np.quantile(quiet, 0.8)) * (1.0 - DOUBTED / math.sqrt(quiet.size))
    for freedom in (3.0, 4.0, 5.0, 7.0, 10.0, 20.0):
        if outer >= student.ppf(0.9, freedom) / student.ppf(0.75, freedom) / 1.4826:
            return freedom
    return 200.0


def _discovery(p: Array) -> Array:
    """Benjamini and Hochberg's adjusted chances, of any shape."""
    flat = p.ravel()
    order = np.argsort(flat)
    scaled = flat[order] * flat.size / (1.0 + np.arange(flat.size))
    adjusted = np.empty_like(flat)
    adjusted[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return adjusted.reshape(p.shape)


def _groups(drives: list[str], signatures: Array) -> tuple[tuple[str, ...], ...]:
    if len(drives) < 2:
        return tuple((drive,) for drive in drives)
    size = np.linalg.norm(signatures, axis=1)
    cosine = np.clip(signatures @ signatures.T / np.maximum(np.outer(size, size), 1e-12), -1.0, 1.0)
    upper = np.triu_indices(len(drives), 1)
    label = fcluster(linkage(1.0 - cosine[upper], "average"), 1.0 - ALIKE, "distance")
    groups = [tuple(d for d, one in zip(drives, label, strict=True) if one == which) for which in sorted(set(label))]
    return tuple(sorted(groups, key=lambda group: (-len(group), group)))

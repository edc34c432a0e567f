"""Datasets of fleets whose truth is known, written by the contract of docs/fleet.md and by nothing of the product.

`worn_fleet`: gears that fail by a Weibull law of their use at a torque exponent, most of them still running.
`mixed_fleet`: healthy gears of which some share an effect that their models lack.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

RATED_NM = 52.0
"""of CSG-20-100"""
EPOCH_S = 1_790_000_000.0
COLUMNS = (
    "gateway",
    "drive",
    "run",
    "topic",
    "sequence",
    "time_s",
    "historical",
    "name",
    "value",
    "sd",
    "status",
    "unit",
)


@dataclass(frozen=True)
class LifeTruth:
    """How the gears of a worn fleet fail."""

    shape: float = 2.0
    exponent: float = 6.0
    scale_h: float = 8000.0
    """characteristic life at rated torque and 1000 rpm"""


def written(folder: Path, messages: Iterable[Mapping[str, Any]], files: int = 4) -> None:
    """`messages`: site, gateway, drive, topic, sequence, time_s and `numbers` (name -> value, or value and status)."""
    rows: dict[tuple[str, int], list[tuple[Any, ...]]] = {}
    for at, message in enumerate(messages):
        for name, told in message["numbers"].items():
            value, status = told if isinstance(told, tuple) else (told, "valid")
            row = (message["gateway"], message["drive"], 1, message["topic"], message["sequence"], message["time_s"],
                   False, name, value, None if value is None else 0.01 * abs(value), status, "1")  # fmt: skip
            rows.setdefault((message["site"], at % files), []).append(row)
    for (site, number), part in rows.items():
        path = folder / f"site={site}" / "date=2026-09-21" / f"part-{number}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(dict(zip(COLUMNS, map(list, zip(*part, strict=True)), strict=True))), path)


def worn_fleet(
    folder: Path, seed: int, drives: int = 200, censored: float = 0.6, truth: LifeTruth = LifeTruth()
) -> None:
    """Every drive at a torque and a speed of its own, set to work at a time of its own, all looked at on one day."""
    rng = np.random.default_rng(seed)
    messages: list[dict[str, Any]] = []
    drawn = [drawn_life(rng, truth) for _ in range(drives)]
    watched_h = rng.uniform(0.1, 1.0, drives)
    reach = np.quantile([life_h / span for (_, _, life_h), span in zip(drawn, watched_h, strict=True)], 1.0 - censored)
    for number, ((torque, rpm, life_h), span) in enumerate(zip(drawn, watched_h * reach, strict=True)):
        failed = bool(life_h <= span)
        hours = min(life_h, span)
        place = {"site": f"hall-{number % 3}", "gateway": f"cell-{number // 10}", "drive": f"axis-{number % 10}"}
        state = (4.0, "failure") if failed else (0.0, "ok")
        messages.append(
            {**place, "topic": "meta", "sequence": 0, "time_s": EPOCH_S, "numbers": {"gear": (None, "CSG-20-100")}}
        )
        for sequence in range(10):
            at = {**place, "sequence": sequence, "time_s": EPOCH_S + 3600.0 * sequence}
            load = {"torque_rms": torque * math.exp(rng.normal(0.0, 0.02)), "speed_in": rpm * math.pi / 30.0}
            messages.append({**at, "topic": "load", "numbers": load})
            messages.append({**at, "topic": "life", "numbers": {"operating_hours": hours - 9.0 + sequence}})
            messages.append({**at, "topic": "health", "numbers": {"ne107": state if sequence == 9 else (0.0, "ok")}})
    written(folder, messages)


def drawn_life(rng: np.random.Generator, truth: LifeTruth) -> tuple[float, float, float]:
    """Torque [N m], speed [rpm] and hours to failure of one gear."""
    torque, rpm = RATED_NM * math.exp(rng.normal(-0.1, 0.25)), 1000.0 * math.exp(rng.normal(0.3, 0.2))
    use_h = truth.scale_h * rng.weibull(truth.shape)
    return torque, rpm, use_h / ((torque / RATED_NM) ** truth.exponent * rpm / 1000.0)


def mixed_fleet(folder: Path, seed: int, drives: int = 280, share: float = 0.05, extra: float = 0.05) -> list[str]:
    """The planted drives (site/gateway/drive): their model misses `extra` of the torque. Load moves every number."""
    rng = np.random.default_rng(seed)
    planted = set(rng.permutation(drives)[: round(share * drives)].tolist())
    messages, names = [], []
    for number in range(drives):
        place = {"site": f"hall-{number % 3}", "gateway": f"cell-{number // 10}", "drive": f"axis-{number % 10}"}
        load, unit = math.exp(rng.normal(0.0, 0.3)), rng.normal(0.0, 0.12, 6)
        floor = 0.01 * math.exp(0.3 * unit[0]) / load**0.5
        for sequence in range(20):
            noise = np.exp(rng.normal(0.0, 0.05, 8))
            lacking = 0.02 * load**0.4 * math.exp(unit[1]) * noise[0]
            if number in planted:
                lacking = math.hypot(lacking, extra * noise[1])
            at = {**place, "sequence": sequence, "time_s": EPOCH_S + 4.0 * sequence}
            error = {"model_nrmse": math.hypot(floor, lacking), "model_noise_floor": floor}
            laws = {"damping": 8.0 * math.exp(unit[2]) * load**0.2 * noise[2],
                    "kinematic_error": 3e-4 * math.exp(unit[3]),
                    "coulomb_friction": 2.0 * load**0.5 * math.exp(unit[4]) * noise[3]}  # fmt: skip
            messages.append({**at, "topic": "model_error", "numbers": error})
            messages.append({**at, "topic": "stiffness", "numbers": laws})
            messages.append(
                {**at, "topic": "load", "numbers": {"torque_rms": 40.0 * load * noise[4], "speed_in": 100.0}}
            )
        if number in planted:
            names.append("/".join(place.values()))
    written(folder, messages)
    return sorted(names)

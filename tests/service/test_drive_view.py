"""What the page draws of one drive, from readings to plain JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_daemon.config.settings import ChannelSettings, Drive, Estimation
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.records import Readings
from edge_daemon.service.drive_view import drive_view
from edge_daemon.service.pipeline import Pipeline
from edge_daemon.usage.gears import find_gear
from tests.motion import simulated_joint as rig

START_S = 1000.0


def pipeline(balance: str, effects: tuple[str, ...], channels: tuple[ChannelSettings, ...], gear: bool) -> Pipeline:
    drive = Drive(name="axis", modbus_device_id=1, model="m", channels=channels, estimation=Estimation(warm_up_s=1.0))
    model = Model(balance, 100.0, 0.05, tuple(ModelEffect(name) for name in effects))  # type: ignore[arg-type]
    return Pipeline(drive, Path("m.toml"), model, find_gear("CSG-32-100") if gear else None)


def moved(made: Pipeline, columns: dict[str, Any]) -> dict[str, Any]:
    """The picture after readings at 1 kHz in batches of a tenth of a second; everything must be JSON."""
    for i in range(0, len(next(iter(columns.values()))), 100):
        time_s = START_S + np.arange(i, i + 100) / 1000.0
        for name, values in columns.items():
            made.push(Readings("can", name, time_s, np.asarray(values[i : i + 100])))
        made.step(time_s[-1] + 0.3, ())
    return dict(json.loads(json.dumps(drive_view(made), allow_nan=False)))


def encoder(channel: str, bits: int) -> ChannelSettings:
    return ChannelSettings(channel=channel, source="can", signal=channel, counts_per_turn=2.0**bits)


def plain(channel: str) -> ChannelSettings:
    return ChannelSettings(channel=channel, source="can", signal=channel)


@pytest.fixture(scope="module")
def torsion() -> tuple[rig.Joint, dict[str, Any]]:
    joint = rig.Joint(out_bits=24)
    theta_in, theta_out = rig.linear(joint, rig.Path(seconds=8.0))
    made = pipeline(
        "torsion",
        ("linear_stiffness", "viscous_damping"),
        (encoder("theta_in_rad", joint.in_bits), encoder("theta_out_rad", joint.out_bits)),
        gear=True,
    )
    counts = (np.round(theta_in / 2 / math.pi * 2**joint.in_bits), np.round(theta_out / 2 / math.pi * 2**24))
    return joint, moved(made, dict(zip(("theta_in_rad", "theta_out_rad"), counts, strict=True)))


def test_the_loop_comes_with_the_stiffness_curve_and_its_band(torsion: tuple[rig.Joint, dict[str, Any]]) -> None:
    joint, view = torsion
    spring, loop = view["loop"]["spring"], view["loop"]
    assert spring["twist_rad"][-1] == pytest.approx(max(abs(v) for v in loop["twist_rad"] if v is not None), rel=0.05)
    for twist, low, high in zip(spring["twist_rad"], spring["low_Nm"], spring["high_Nm"], strict=True):
        assert low - 1e-3 <= joint.stiffness * twist <= high + 1e-3
    assert spring["high_Nm"][-1] - spring["low_Nm"][-1] < 0.2 * spring["torque_Nm"][-1]


def test_the_makers_curve_is_the_catalogues(torsion: tuple[rig.Joint, dict[str, Any]]) -> None:
    """CSG-32-100: K1 6.7e4 N m/rad up to 29 N m, K2 1.1e5 up to 108 N m (maker's catalogue)."""
    maker = torsion[1]["loop"]["maker"]
    assert torsion[1]["loop"]["maker_name"] == "CSG-32-100"
    assert maker[:3] == [
        [0.0, 0.0],
        [pytest.approx(29 / 6.7e4, rel=1e-3), 29.0],
        [pytest.approx(29 / 6.7e4 + 79 / 1.1e5, rel=1e-3), 108.0],
    ]


def test_loads_are_counted_and_alarms_listed(torsion: tuple[rig.Joint, dict[str, Any]]) -> None:
    view = torsion[1]
    assert sum(view["load"]["cycles"]) > 5 and view["load"]["peak_Nm"] > 1
    assert view["alarms"] == [] and view["channels"] == ["theta_in_rad", "theta_out_rad"]


def test_a_drive_with_one_encoder_has_a_picture_without_twist() -> None:
    t = np.arange(4000) / 1000.0
    theta = 0.5 * np.sin(2 * math.pi * t)
    current = 3.0 * np.sign(np.cos(2 * math.pi * t)) - 4 * math.pi**2 * 0.05 * theta
    made = pipeline(
        "drive", ("inertia", "coulomb_friction"), (plain("theta_out_rad"), plain("current_in_A")), gear=False
    )
    view = moved(made, {"theta_out_rad": theta, "current_in_A": current})
    assert view["loop"] is None and view["noise"] is None
    assert view["model"]["balance"] == "drive" and view["gear"] is None


def test_a_drive_without_an_encoder_at_the_motor_has_a_picture() -> None:
    made = pipeline("torsion", ("linear_stiffness",), (plain("theta_out_rad"),), gear=False)
    view = moved(made, {"theta_out_rad": np.sin(np.arange(3000) / 200.0)})
    assert view["loop"] is None and view["channels"] == ["theta_out_rad"]

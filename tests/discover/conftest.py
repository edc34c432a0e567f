"""What a model leaves of three gears, made once."""

from __future__ import annotations

import numpy as np
import pytest

from edge_daemon.discover.leftover import Leftover
from edge_daemon.effects.model import Model, ModelEffect
from edge_daemon.rig.recording import Simulated, simulate
from tests.discover.laws import DRIVEN, LAWS, SECONDS, joint, left_by


@pytest.fixture(scope="session")
def healthy() -> Leftover:
    recording = simulate(seconds=9.0, seed=1)
    return left_by(recording, joint(recording))


@pytest.fixture(scope="session")
def magnet() -> Leftover:
    recording = simulate(seed=3, bits_out=24, laws=(DRIVEN["dragging_magnet"],), balance="drive")
    return left_by(recording, Model("drive", 100.0, np.nan, (ModelEffect("inertia"),)))


@pytest.fixture(scope="session")
def limited() -> Simulated:
    return simulate(seconds=SECONDS, seed=8, bits_out=22, laws=(LAWS["limited_drag"],))

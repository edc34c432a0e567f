"""What the drive in the guest does, simulated here, where it is quick: encoder counts and a sensor's registers."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from edge_daemon.rig import bmp280
from edge_daemon.rig.live import live_drive

SECONDS, RATE_HZ, SIMULATED_HZ = 300, 100, 1000
SEED = 1
ROW = struct.Struct("<iihhi")
SHOWN = {bmp280.REGISTER_CALIBRATION: 24, bmp280.REGISTER_ID: 1, bmp280.REGISTER_DATA: 6}
"""Registers that a reader of the part looks at, and how many bytes of each."""


def write(folder: Path) -> None:
    """`course.bin` and `housing.json`, the same ones each time."""
    samples = live_drive(SEED).advance(float(SECONDS))
    every = slice(None, None, SIMULATED_HZ // RATE_HZ)
    rows = zip(
        samples.counts_in[every].tolist(),
        samples.counts_out[every].tolist(),
        np.rint(samples.motor_torque_Nm[every] * 1000).astype(int).tolist(),
        np.rint(samples.motor_current_A[every] * 100).astype(int).tolist(),
        np.rint(samples.motor_speed_rad_s[every] * 1000).astype(int).tolist(),
        strict=True,
    )
    (folder / "course.bin").write_bytes(b"".join(ROW.pack(*row) for row in rows))
    (folder / "housing.json").write_text(json.dumps([_shown(25.0 + 0.05 * i) for i in range(100)]))


def _shown(temperature_degC: float) -> dict[str, object]:
    truth = temperature_degC, 101_325.0
    part = bmp280.Bmp280(lambda: truth)
    part.write(bmp280.REGISTER_CONTROL, bytes([bmp280.MODE_NORMAL]))
    registers = {str(register): part.read(register, length).hex() for register, length in SHOWN.items()}
    return {"temperature_degC": truth[0], "pressure_Pa": truth[1], "registers": registers}

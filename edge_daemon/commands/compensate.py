"""`compensate`: what to command so that the output is where it should be, from a fitted model. Moves nothing."""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np

from edge_daemon.compensate.feedforward import Feedforward, Trajectory, feedforward
from edge_daemon.compensate.gate import confirmed
from edge_daemon.compensate.stream import DriveScale, OffsetBounds, OffsetStream, streamed
from edge_daemon.compensate.tables import Tables, tables
from edge_daemon.effects.algebra import derivative
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.recordings.recording import read_recording
from edge_daemon.text import write_text, written_as_json

UNEVEN = 0.01
"""A cycle that lasts a hundredth longer than another is a rounded stamp's; more is another motion."""


def compensate(arguments: argparse.Namespace) -> None:
    """Tables, a C header and a shaper; parts that a recording does not confirm are off."""
    if not (0 < arguments.limit < float("inf") and 0 < arguments.torque < float("inf")):
        raise BadInput("--limit and --torque: expected numbers above 0")
    if (arguments.trajectory is None) is not (arguments.stream is None):
        raise BadInput("--trajectory and --stream: one needs the other")
    ready = feedforward(read_model(arguments.model))
    if arguments.recording:
        read = read_recording(arguments.recording)
        try:
            ready = confirmed(ready, read.time_s, read.columns)
        except BadInput as error:
            raise BadInput(f"{arguments.recording}: {error}") from error
    found: Tables = tables(ready, arguments.torque, arguments.limit, arguments.recording is not None)
    if arguments.csv:
        write_text(arguments.csv, found.as_csv())
    if arguments.header:
        write_text(arguments.header, found.as_header(arguments.model.name))
    if arguments.stream:
        _stream(ready, arguments)
    if not written_as_json(found.to_json(), arguments.json):
        print(found.in_words())


def _stream(ready: Feedforward, arguments: argparse.Namespace) -> None:
    """The offsets of a planned motion of the output, cycle by cycle, as a drive takes them."""
    scale = DriveScale(arguments.counts_per_turn / (2.0 * math.pi), arguments.rated_torque)
    if not (0 < scale.counts_per_rad < math.inf and 0 < scale.rated_torque_Nm < math.inf):
        raise BadInput("--counts-per-turn and --rated-torque: expected numbers above 0")
    read = read_recording(arguments.trajectory)
    angle, step_s = read.columns.get("theta_out_rad"), np.diff(read.time_s)
    if angle is None or len(angle) < 3 or not np.isfinite(angle).all():
        raise BadInput(f"{arguments.trajectory}: expected time_s and theta_out_rad, three numbers or more each")
    if np.ptp(step_s) > UNEVEN * np.median(step_s):
        raise BadInput(f"{arguments.trajectory}: time_s: expected the drive's cycle, evenly")
    rate_hz = float(1.0 / np.median(step_s))
    speed = derivative(angle, rate_hz)
    path = Trajectory(rate_hz, angle, speed, derivative(speed, rate_hz), read.columns.get("torque_model_Nm"))
    stream = OffsetStream(OffsetBounds(position_rad=arguments.limit), scale)
    write_text(arguments.stream, "\n".join(streamed(ready.offsets(path), rate_hz, stream)) + "\n")
    if stream.bounded:
        print(f"{stream.bounded} of {len(angle)} cycles are held at a limit", file=sys.stderr)

"""`compensate`: what to command so that the output is where it should be, from a fitted model. Moves nothing."""

from __future__ import annotations

import argparse

from edge_daemon.acquire.recording import read_recording
from edge_daemon.compensate.feedforward import feedforward
from edge_daemon.compensate.gate import confirmed
from edge_daemon.compensate.tables import Tables, tables
from edge_daemon.effects.model_file import read_model
from edge_daemon.errors import BadInput
from edge_daemon.text import write_text, written_as_json


def compensate(arguments: argparse.Namespace) -> None:
    """Tables, a C header and a shaper; parts that a recording does not confirm are off."""
    if not (0 < arguments.limit < float("inf") and 0 < arguments.torque < float("inf")):
        raise BadInput("--limit and --torque: expected numbers above 0")
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
    if not written_as_json(found.to_json(), arguments.json):
        print(found.in_words())

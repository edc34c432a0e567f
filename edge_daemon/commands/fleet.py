"""Commands over many gateways: collect, status, learn and compare."""

from __future__ import annotations

import argparse
import logging
import math
import signal
import sys
import threading
from typing import Any

from edge_daemon.errors import BadInput
from edge_daemon.text import written_as_json


def collect(arguments: argparse.Namespace) -> None:
    """Write what all gateways publish into a folder, until SIGTERM, SIGINT or `--seconds`."""
    from edge_daemon.fleet.collector import Collector

    _say_on_standard_error()
    if arguments.seconds is not None and not 0.0 < arguments.seconds < math.inf:
        raise BadInput(f"--seconds {arguments.seconds:g}: expected more than 0")
    collector = Collector(arguments.connect, arguments.out, arguments.zenoh)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: collector.stop())
    if arguments.seconds is not None:
        timer = threading.Timer(arguments.seconds, collector.stop)
        timer.daemon = True
        timer.start()
    collector.run()
    found: dict[str, Any] = {**collector.counts, "lost": collector.lost}
    if not written_as_json(found, arguments.json):
        print(", ".join(f"{count} {name}" for name, count in found.items()))


def _say_on_standard_error() -> None:
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(message)s", stream=sys.stderr)

"""The newest prior for whoever asks: published at once, and answered to gateways that come later."""

from __future__ import annotations

import math
import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from edge_daemon.errors import BadInput
from edge_daemon.fleet.link import FleetLink
from edge_daemon.fleet.prior import prior_from
from edge_daemon.fleet.signed import key_from, place_of, signed

CONNECT_S = 10.0
"""A router that does not answer for so long is not there."""


def shared(
    endpoints: Sequence[str], file: Path, key_file: Path, zenoh: Path | None, seconds: float | None
) -> dict[str, Any]:
    """Offer a prior until SIGTERM, SIGINT or for so long; what was done. Raises `BadInput`."""
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise BadInput(f"--seconds {seconds:g}: expected more than 0")
    try:
        blob = file.read_bytes()
    except OSError as error:
        raise BadInput(f"{file}: cannot read: {error.strerror}") from error
    key = key_from(key_file)
    try:
        envelope, prior = signed(blob, key), prior_from(blob)
    except BadInput as error:
        raise BadInput(f"{file}: {error}") from error
    assert prior is not None  # `signed` has looked
    stop = threading.Event()
    for which in (signal.SIGTERM, signal.SIGINT):
        signal.signal(which, lambda *_: stop.set())
    link = FleetLink(endpoints, file=zenoh, offers={place_of(prior.gear): envelope})
    try:
        if not link.connected(CONNECT_S):
            raise BadInput(f"--connect {' '.join(endpoints)}: nobody answers: expected a router or a gateway")
        stop.wait(seconds)
        return {"gear": prior.gear, "number": prior.number, "drives": prior.drives, "asked": link.asked}
    finally:
        link.close()

"""What a drive's forecast begins with: the maker's law, a file's, or the newest that the fleet has signed."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from pathlib import Path

from edge_daemon.config.settings import Drive, Zenoh
from edge_daemon.errors import BadInput
from edge_daemon.fleet.prior import FleetPrior, as_rated, of_this_gear, prior_from
from edge_daemon.fleet.signed import key_from, opened
from edge_daemon.prognose.forecast import MAKERS, Prior
from edge_daemon.prognose.learn import prior_from_bytes
from edge_daemon.usage.gears import Gear
from edge_daemon.usage.ledger import Ledger

log = logging.getLogger(__name__)

PriorAt = Callable[[Ledger], Prior]
WAITING = 8
"""So many envelopes wait to be opened; the oldest make room."""


class PriorInbox:
    """Envelopes from the network, opened once; the newest prior of each gear."""

    def __init__(self, key: bytes | None) -> None:
        self.key = key
        self._arrived: deque[bytes] = deque(maxlen=WAITING)
        self._newest: dict[str, tuple[bytes, FleetPrior]] = {}
        self._refused = ""

    def hear(self, envelope: bytes) -> None:
        """In any thread."""
        self._arrived.append(envelope)

    def newest(self, gear: str) -> tuple[bytes, FleetPrior] | None:
        """Envelope and prior of a gear; None where nothing was signed for it."""
        while self._arrived and self.key is not None:
            self._open(self._arrived.popleft(), self.key)
        return self._newest.get(gear)

    def _open(self, envelope: bytes, key: bytes) -> None:
        try:
            prior = opened(envelope, key)
        except BadInput as error:
            level = logging.DEBUG if str(error) == self._refused else logging.WARNING
            self._refused = str(error)
            log.log(level, "a prior from the fleet is not taken: %s", error)
            return
        before = self._newest.get(prior.gear)
        if before is None or prior.number > before[1].number:
            self._newest[prior.gear] = envelope, prior


class DrivePrior:
    """The prior of one drive; `offer` and `restore` take a later one of the fleet over."""

    def __init__(self, gear: Gear | None, of_file: PriorAt | None = None, key: bytes | None = None) -> None:
        self._gear, self._key = gear, key
        self._of_file = of_file
        self._envelope = b""
        self.fleet: FleetPrior | None = None

    def at(self, ledger: Ledger) -> Prior:
        """What is believed of a drive with this past."""
        if self._of_file is not None:
            return self._of_file(ledger)
        if self.fleet is None or self._gear is None:
            return MAKERS
        return self.fleet.at(ledger if float(ledger.fatigue.sum()) > 0.0 else as_rated(self._gear))

    def offer(self, envelope: bytes, prior: FleetPrior) -> str:
        """What changes by it, in words; empty where nothing does. A file of the configuration stands above it."""
        if self._gear is None or self._of_file is not None or prior.gear != self._gear.name:
            return ""
        if self.fleet is not None and prior.number <= self.fleet.number:
            return ""
        self._envelope, self.fleet = envelope, prior
        lives = f"{prior.drives} lives of such gears, {prior.failed} of them to their end"
        return f"remaining life is now told by what the fleet has learned from {lives} (prior {prior.number})"

    def state(self) -> bytes:
        """For `restore`: the envelope, which is opened again with the key."""
        return self._envelope

    def restore(self, envelope: bytes) -> bool:
        """False where it is not what this gateway would take from the fleet today."""
        if not envelope or self._key is None:
            return not envelope
        try:
            self.offer(envelope, opened(envelope, self._key))
        except BadInput:
            return False
        return True


def key_of(link: Zenoh, base: Path) -> bytes | None:
    """With which priors of the fleet are signed; None where none is taken. Raises `BadInput`."""
    return None if link.prior_key_file is None else key_from(base / link.prior_key_file)


def prior_of(drive: Drive, gear: Gear | None, base: Path) -> PriorAt | None:
    """What a drive's file says; None without one. Raises `BadInput`, which begins with the key."""
    if drive.prior is None:
        return None
    file = base / drive.prior
    if gear is None:
        raise BadInput(f"prior: {file}: expected a `gear` beside it")
    try:
        return _read(file.read_bytes(), gear)
    except OSError as error:
        raise BadInput(f"prior: {file}: cannot read: {error.strerror}") from error
    except BadInput as error:
        raise BadInput(f"prior: {file}: {error}") from error


def _read(blob: bytes, gear: Gear) -> PriorAt:
    fleet = prior_from(blob)
    if fleet is not None:
        of_this_gear(fleet.gear, gear)
        own = DrivePrior(gear)
        own.offer(blob, fleet)
        return own.at
    learned = prior_from_bytes(blob)
    if learned.experience is not None:
        of_this_gear(learned.experience.gear, gear)
    return lambda ledger: learned

"""A prior on its way to the gateways: signed, so that only who has the key decides what they believe.

The signature is HMAC-SHA256 (Krawczyk, Bellare and Canetti 1997, RFC 2104) over the very bytes of the prior: all that
know the key may sign, gateways too, so the key belongs to one site.
"""

from __future__ import annotations

import hmac
from pathlib import Path
from urllib.parse import quote

import msgspec

from edge_daemon.errors import BadInput
from edge_daemon.fleet.prior import FleetPrior, prior_from

PRIORS = "strainwave/priors/v1"
"""Below this key stand the priors, by gear."""
SCHEMA = "strainwave/signed_prior"
SCHEMA_VERSION = 1
SHORTEST_KEY = 32
"""A key of so many characters or more cannot be guessed if it was drawn at random."""
MOST_BYTES = 2**20
"""A prior of 400 laws has 25 kB: what is longer than this is not looked at."""


class _Envelope(msgspec.Struct, frozen=True):
    schema: str
    schema_version: int
    signature: str
    prior: bytes
    """as base64 in JSON"""


def key_from(file: Path) -> bytes:
    """The key in a file. Raises `BadInput`."""
    try:
        key = file.read_bytes().strip()
    except OSError as error:
        raise BadInput(f"{file}: cannot read: {error.strerror}") from error
    if len(key) < SHORTEST_KEY:
        raise BadInput(f"{file}: {len(key)} characters: expected {SHORTEST_KEY} or more, drawn at random")
    return key


def place_of(gear: str) -> str:
    """Under which key the prior of a gear stands."""
    return f"{PRIORS}/{quote(gear, safe='')}"


def signed(prior: bytes, key: bytes) -> bytes:
    """The envelope of a prior. Raises `BadInput` if it is none of a fleet."""
    if prior_from(prior) is None:
        raise BadInput("expected what `fleet learn --out` has written")
    return msgspec.json.encode(_Envelope(SCHEMA, SCHEMA_VERSION, _signature(prior, key), prior))


def opened(envelope: bytes, key: bytes) -> FleetPrior:
    """The prior in an envelope. Raises `BadInput` if this key did not sign it, or it is broken."""
    if len(envelope) > MOST_BYTES:
        raise BadInput(f"{len(envelope)} bytes: expected at most {MOST_BYTES}")
    try:
        found = msgspec.json.decode(envelope, type=_Envelope)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"no signed prior: {error}") from error
    if (found.schema, found.schema_version) != (SCHEMA, SCHEMA_VERSION):
        raise BadInput(f"{found.schema!r} of version {found.schema_version}: expected {SCHEMA} of {SCHEMA_VERSION}")
    if not hmac.compare_digest(found.signature.encode(), _signature(found.prior, key).encode()):
        raise BadInput("not signed with the key of this gateway")
    prior = prior_from(found.prior)
    if prior is None:
        raise BadInput("signed, but no fleet's prior")
    return prior


def _signature(prior: bytes, key: bytes) -> str:
    return hmac.new(key, prior, "sha256").hexdigest()

"""The one error a user causes and a user can mend, and what the system says in its own words."""

from __future__ import annotations

import errno
import os


class BadInput(Exception):
    """One line that names the file or key, what is wrong there, and what was expected. Commands exit with 2."""


def why_not_listening(error: OSError) -> str:
    """What keeps a server from its address, without the words that asyncio puts around it."""
    if error.errno is None or error.errno <= 0:  # a name that cannot be resolved has a number of its own
        return error.strerror or str(error)
    hints = {
        errno.EADDRINUSE: ": another program listens there",
        errno.EADDRNOTAVAIL: ": expected an address of this computer",
        errno.EACCES: ": expected a port from 1024 up",
    }
    return os.strerror(error.errno) + hints.get(error.errno, "")

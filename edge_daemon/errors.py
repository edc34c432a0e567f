"""The one error a user causes and a user can mend, and what the system says in its own words."""

from __future__ import annotations

import errno
import os

LONGEST_REFUSAL = 600
"""A refusal says no more characters than this: what is wrong may be a megabyte long."""


def in_one_line(text: str) -> str:
    """The text without what breaks a line or commands a terminal, its middle left out where it is long."""
    plain = "".join(letter if letter.isprintable() else " " for letter in text)
    half = LONGEST_REFUSAL // 2
    return plain if len(plain) <= LONGEST_REFUSAL else f"{plain[:half]} ... {plain[-half:]}"


class BadInput(Exception):
    """One line that names the file or key, what is wrong there, and what was expected. Commands exit with 2.

    What is quoted of the input may be anything: it breaks no line and commands no terminal.
    """

    def __init__(self, line: str = "") -> None:
        super().__init__(in_one_line(line))


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

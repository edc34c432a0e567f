"""What systemd is told: READY, STATUS, WATCHDOG, STOPPING (sd_notify(3))."""

from __future__ import annotations

import os
import socket


class Notifier:
    """Sends datagrams to $NOTIFY_SOCKET; does nothing where there is none. Never raises: a lost word to the
    service manager must not end a measurement."""

    def __init__(self, address: str | None = None) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "") if address is None else address
        if self._address.startswith("@"):  # the abstract namespace is written with a leading @
            self._address = "\0" + self._address[1:]

    def send(self, **words: str | int) -> None:
        """`send(READY=1, STATUS="measuring")`"""
        if not self._address:
            return
        text = "\n".join(f"{word}={value}" for word, value in words.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as link:
                link.setblocking(False)
                link.sendto(text.encode(), self._address)
        except OSError:
            return

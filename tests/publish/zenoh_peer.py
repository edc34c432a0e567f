"""An independent Zenoh program, run as a process of its own: a router, a subscriber or an asker.

    zenoh_peer.py router PORT
    zenoh_peer.py subscribe PORT KEY        every sample as a JSON line
    zenoh_peer.py liveliness PORT KEY       `PUT key` / `DELETE key`
    zenoh_peer.py get PORT SELECTOR         every answer as a JSON line, then ends

It says `ready` first, and ends by itself after a minute or when its standard input closes.
"""

from __future__ import annotations

import json
import os
import sys
import threading

import zenoh

LIFE_S = 60.0


def configuration(mode: str, **endpoints: list[str]) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for key in ("listen", "connect"):
        config.insert_json5(f"{key}/endpoints", json.dumps(endpoints.get(key, [])))
    return config


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def show(sample: zenoh.Sample) -> None:
    say(
        json.dumps(
            {"key": str(sample.key_expr), "encoding": str(sample.encoding)} | json.loads(sample.payload.to_string())
        )
    )


def main(role: str, port: str, key: str = "**") -> None:
    here = f"tcp/127.0.0.1:{port}"
    if role == "router":
        session = zenoh.open(configuration("router", listen=[here]))
    else:
        session = zenoh.open(configuration("client", connect=[here]))
    if role == "subscribe":
        session.declare_subscriber(key, show)
    elif role == "liveliness":
        session.liveliness().declare_subscriber(
            key, lambda sample: say(f"{str(sample.kind).rpartition('.')[2]} {sample.key_expr}"), history=True
        )
    elif role == "get":
        for answer in session.get(key, target=zenoh.QueryTarget.ALL, timeout=5.0):
            say(json.dumps({"error": answer.err.payload.to_string()})) if answer.err else show(answer.ok)
        session.close()
        return
    say("ready")
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    threading.Timer(LIFE_S, os._exit, (1,)).start()
    main(*sys.argv[1:])
    os._exit(0)

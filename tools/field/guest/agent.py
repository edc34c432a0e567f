"""In the guest: runs the commands that come as JSON lines on a virtio-serial port, each in a thread, and answers.

{"run": "a shell's command", "timeout_s": 60}, or {"get": "/health"} of the daemon's page.
"""

import json
import os
import subprocess
import threading
import time
import urllib.error
import urllib.request

PORT = "/dev/virtio-ports/agent"
PAGE = "http://127.0.0.1:8080"


def ran(command: str, timeout_s: float) -> tuple[int, bytes]:
    """Exit code and what was said."""
    try:
        done = subprocess.run(
            ["/bin/sh", "-c", command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout_s,
        )
    except subprocess.TimeoutExpired as late:
        return 124, late.stdout or b""
    return done.returncode, done.stdout


def got(path: str, timeout_s: float) -> tuple[int, bytes]:
    """Status and body; 0 where nobody answers."""
    try:
        with urllib.request.urlopen(PAGE + path, timeout=timeout_s) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()
    except OSError as error:
        return 0, str(error).encode()


def answered(request: dict) -> bytes:
    """One line."""
    timeout_s = request["timeout_s"]
    code, said = got(request["get"], timeout_s) if "get" in request else ran(request["run"], timeout_s)
    answer = {"id": request["id"], "code": code, "said": said.decode(errors="replace"), "time_s": time.time()}
    return json.dumps(answer).encode() + b"\n"


def main() -> None:
    """Until the machine ends."""
    port = os.open(PORT, os.O_RDWR)
    lock, rest = threading.Lock(), b""

    def serve(line: bytes) -> None:
        answer = answered(json.loads(line))
        with lock:
            while answer:
                answer = answer[os.write(port, answer) :]

    while True:
        data = os.read(port, 65_536)
        if not data:  # nobody holds the other end yet
            time.sleep(0.1)
            continue
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            threading.Thread(target=serve, args=(line,), daemon=True).start()


main()

"""How much of a processor this computer leaves to us: a guest that is starved fails for reasons that are not ours."""

from __future__ import annotations

import threading
import time

SPIN_S, EVERY_S = 0.02, 1.0
"""A spin is longer than a scheduler's slice, and costs two hundredths of a processor."""
LEAST = 0.5
"""Below this part of a processor a guest loses frames at rest and misses deadlines (guess)."""


class Share:
    """Measures from its making on, in a thread that ends with the process."""

    def __init__(self) -> None:
        self.wanted_s = self.given_s = 0.0
        threading.Thread(target=self._measure, name="share", daemon=True).start()

    def _measure(self) -> None:
        while True:
            begun_s, own_s = time.monotonic(), time.thread_time()
            while time.thread_time() - own_s < SPIN_S:
                pass
            self.given_s += SPIN_S
            self.wanted_s += time.monotonic() - begun_s
            time.sleep(EVERY_S)

    @property
    def now(self) -> tuple[float, float]:
        """What was wanted and given so far [s], to count from."""
        return self.wanted_s, self.given_s

    def since(self, then: tuple[float, float] = (0.0, 0.0)) -> float:
        """Given part of what was wanted; 1 where nothing was measured yet."""
        wanted_s, given_s = self.wanted_s - then[0], self.given_s - then[1]
        return given_s / wanted_s if wanted_s > 0 else 1.0

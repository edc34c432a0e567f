"""For all tests: one thread for matrices of a few columns, two only cost; no job yields, and no test is judged by its
time."""

import os
from pathlib import Path

for library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# a page's jobs yield to whoever else wants the processor, which beside another worker is for ever
UNYIELDING = str(Path(__file__).parent / "unyielding")
if UNYIELDING not in os.environ.get("PATH", ""):  # a worker has it already
    os.environ["PATH"] = os.pathsep.join([UNYIELDING, os.environ.get("PATH", "")])


def pytest_configure() -> None:
    """A generated example may take as long as the machine makes it."""
    from hypothesis import HealthCheck, settings

    settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("untimed")

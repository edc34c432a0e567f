"""For all tests: one thread for matrices of a few columns, two only cost; and no test is judged by its time."""

import os

for library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_configure() -> None:
    """A generated example may take as long as the machine makes it."""
    from hypothesis import HealthCheck, settings

    settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("untimed")

"""For all tests: one thread for matrices of a few columns, two only cost; no job yields, and no test is judged by its
time."""

import os
from pathlib import Path
from zlib import crc32

import pytest

PARTS = 10
"""Of the slow tests each change runs one part, by its own key: every test is run by every tenth change, and by
`./tools/test --all`."""

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


def pytest_addoption(parser: pytest.Parser) -> None:
    """What `tools/test` asks for."""
    parser.addoption("--part", default="", metavar="KEY", help="of the slow tests one part alone, by this key")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out the slow tests that are another change's."""
    key = config.getoption("part")
    others = [row for row in items if row.get_closest_marker("slow") and crc32(f"{key}{row.nodeid}".encode()) % PARTS]
    if key and others:
        config.hook.pytest_deselected(items=others)
        out = set(map(id, others))
        items[:] = [row for row in items if id(row) not in out]

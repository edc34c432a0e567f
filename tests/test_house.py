"""The walls of the house: who may import whom, how deep folders go, and what no module may hold."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "edge_daemon"
VOCABULARY = {"channels", "clock", "errors", "plain", "quantities", "records", "settings", "units"}
MAY_IMPORT: dict[str, set[str]] = {
    "acquire": set(),
    "condition": set(),
    "effects": set(),
    "estimate": {"effects"},
    "excite": set(),
    "explain": {"effects", "estimate"},
    "prognose": set(),
    "publish": set(),
    "rig": set(),
    "show": set(),
    "store": set(),
}
PURE = ("condition", "effects", "estimate", "explain", "prognose")
IMPURE_MODULES = {"asyncio", "threading", "socket", "time", "can", "smbus2", "pymodbus", "zenoh", "aiohttp"}
HEAVY_MODULES = {"scipy.signal", "matplotlib", "pyarrow", "pandas", "numba", "edge_daemon.explain"}


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def imported(path: Path) -> set[str]:
    """Dotted names that a module imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@pytest.mark.parametrize("stage", MAY_IMPORT)
def test_a_stage_imports_only_its_own_and_what_stands_to_its_left(stage: str) -> None:
    for path in (PACKAGE / stage).rglob("*.py"):
        for name in imported(path):
            if not name.startswith("edge_daemon."):
                continue
            room = name.split(".")[1]
            allowed = {stage} | MAY_IMPORT[stage] | VOCABULARY | {"__version__"}
            assert room in allowed, f"{path.relative_to(PACKAGE)} imports {name}"


@pytest.mark.parametrize("stage", PURE)
def test_the_middle_knows_no_clock_no_loop_and_no_bus(stage: str) -> None:
    for path in (PACKAGE / stage).rglob("*.py"):
        found = {name.split(".")[0] for name in imported(path)} & IMPURE_MODULES
        assert not found, f"{path.relative_to(PACKAGE)} imports {found}"


def test_what_the_daemon_loads_does_not_pull_in_heavy_libraries() -> None:
    """Checked on the real thing: a fresh interpreter imports the daemon and lists what came along."""
    import subprocess
    import sys

    code = "import sys, edge_daemon.daemon; print('\\n'.join(sys.modules))"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & HEAVY_MODULES


def test_folders_are_one_level_deep_and_named_for_a_stage() -> None:
    folders = {path.parent.relative_to(PACKAGE) for path in modules()}
    assert {str(folder) for folder in folders} <= {".", *MAY_IMPORT}


def test_every_public_module_says_what_it_is_for() -> None:
    for path in modules():
        assert ast.get_docstring(tree(path)), f"{path} has no docstring"

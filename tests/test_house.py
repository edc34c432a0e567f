"""The walls of the house: who may import whom, how deep folders go, and what no module may hold."""

from __future__ import annotations

import ast
import itertools
import re
from functools import cache
from pathlib import Path

import pytest

from edge_daemon.effects.catalogue import CATALOGUE
from edge_daemon.quantities import QUANTITIES

PACKAGE = Path(__file__).parent.parent / "edge_daemon"
PURE = (
    *(
        "condition",
        "integrator",
        "effects",
        "motion",
        "encoders",
        "balance",
        "identify",
        "stiffness",
        "track",
        "sound",
        "search",
        "explain",
        "discover",
    ),
    *("faults", "usage", "health", "prognose", "design", "compensate"),
)
VOCABULARY = {"channels", "clock", "errors", "quantities", "records", "text", "units"}
LOOSE = VOCABULARY | {"__init__", "__main__", "cli"}
SETTINGS = "edge_daemon.config.settings"
"""The settings are types that every room may name; reading them is the business of `config`."""
MAY_IMPORT: dict[str, set[str]] = {
    "config": set(),
    "recordings": set(),
    "acquire": {"recordings"},
    "condition": set(),
    "integrator": set(),
    "effects": {"integrator"},
    "motion": {"integrator", "effects"},
    "encoders": {"effects", "motion"},
    "balance": {"effects", "motion"},
    "identify": {"integrator", "effects", "motion", "balance"},
    "stiffness": {"effects", "motion", "identify"},
    "track": {"integrator", "effects", "motion", "encoders"},
    "sound": set(),
    "search": {"integrator", "effects", "motion", "balance", "identify"},
    "explain": {"effects", "motion", "balance", "identify", "search"},
    "discover": {"effects", "motion", "balance", "identify", "search", "explain"},
    "faults": set(),
    "usage": set(),
    "health": {"faults", "usage"},
    "prognose": {"faults", "usage"},
    "compensate": {"effects"},
    "excite": set(),
    "store": set(),
    "publish": set(),
    "show": set(),
    "design": {"usage", "prognose", "show"},
    "fleet": {"usage", "prognose"},
    "gear": set(),
    "rig": {"gear"},
    "servo": {"rig", "gear"},
    "service": set(PURE) - {"design", "compensate"}
    | {"config", "recordings", "acquire", "excite", "store", "publish", "show", "fleet"},
    "commands": set(PURE)
    | {"config", "recordings", "acquire", "excite", "store", "publish", "show", "fleet", "rig", "servo", "service"},
    "demo": {"effects", "identify", "usage", "compensate", "config", "excite", "rig", "servo", "service", "commands"},
}
MOST_FILES = 25
MOST_LINES = 3800
"""A room that needs more is two rooms."""
IMPURE_MODULES = {"asyncio", "threading", "socket", "time", "can", "smbus2", "pymodbus", "zenoh", "aiohttp"}
HEAVY_MODULES = {
    "scipy.signal",
    "matplotlib",
    "pyarrow",
    "pandas",
    "numba",
    "edge_daemon.search",
    "edge_daemon.explain",
}


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


@pytest.mark.slow
@pytest.mark.parametrize("stage", MAY_IMPORT)
def test_a_stage_imports_only_its_own_and_what_stands_to_its_left(stage: str) -> None:
    for path in (PACKAGE / stage).rglob("*.py"):
        for name in imported(path):
            if not name.startswith("edge_daemon.") or name.startswith(SETTINGS):
                continue
            room = name.split(".")[1]
            allowed = {stage} | MAY_IMPORT[stage] | VOCABULARY | {"__version__"}
            assert room in allowed, f"{path.relative_to(PACKAGE)} imports {name}"


@pytest.mark.parametrize("stage", PURE)
def test_the_middle_knows_no_clock_no_loop_and_no_bus(stage: str) -> None:
    for path in (PACKAGE / stage).rglob("*.py"):
        found = {name.split(".")[0] for name in imported(path)} & IMPURE_MODULES
        assert not found, f"{path.relative_to(PACKAGE)} imports {found}"


@pytest.mark.slow
def test_what_the_daemon_loads_does_not_pull_in_heavy_libraries() -> None:
    """Checked on the real thing: a fresh interpreter imports the daemon and lists what came along."""
    import subprocess
    import sys

    code = "import sys, edge_daemon.service.daemon; print('\\n'.join(sys.modules))"
    loaded = set(
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    )
    assert not loaded & HEAVY_MODULES


def test_folders_are_one_level_deep_and_named_for_a_stage() -> None:
    folders = {path.parent.relative_to(PACKAGE) for path in modules()}
    assert {str(folder) for folder in folders} <= {".", *MAY_IMPORT}


def test_nothing_stands_loose_but_the_vocabulary_and_the_way_in() -> None:
    assert {path.stem for path in PACKAGE.glob("*.py")} == LOOSE
    for name in VOCABULARY:
        rooms = {found.split(".")[1] for found in imported(PACKAGE / f"{name}.py") if found.startswith("edge_daemon.")}
        assert rooms <= VOCABULARY


@pytest.mark.parametrize("room", MAY_IMPORT)
def test_a_room_can_be_overseen(room: str) -> None:
    files = list((PACKAGE / room).glob("*.py"))
    assert len(files) <= MOST_FILES and sum(len(path.read_text().splitlines()) for path in files) <= MOST_LINES


def test_rooms_import_in_one_direction() -> None:
    """Each room only those before it in the order of the table: so no circle."""
    order = list(MAY_IMPORT)
    for room, others in MAY_IMPORT.items():
        before = {other for other in others if order.index(other) < order.index(room)}
        assert before == others


def test_a_type_name_stands_for_one_thing() -> None:
    places: dict[str, list[str]] = {}
    for path in modules():
        for node in tree(path).body:
            name = _type_name(node)
            if name and not name.startswith("_"):
                places.setdefault(name, []).append(str(path.relative_to(PACKAGE)))
    assert not {name: rows for name, rows in places.items() if len(rows) > 1}


def _type_name(node: ast.stmt) -> str | None:
    """The name of a class or of a type's alias."""
    if isinstance(node, ast.ClassDef):
        return node.name
    target = (
        node.targets[0] if isinstance(node, ast.Assign) else node.target if isinstance(node, ast.AnnAssign) else None
    )
    name = target.id if isinstance(target, ast.Name) else ""
    return name if name[:1].isupper() and not name.isupper() else None


def test_every_public_module_says_what_it_is_for() -> None:
    for path in modules():
        assert ast.get_docstring(tree(path)), f"{path} has no docstring"


BEGINNINGS = {
    *("stiffness/methods.py", "commands/practice.py", "stiffness/stiffness_map.py"),
    *("demo/moved_drive.py", "demo/compensated_drive.py"),
}
"""Modules that begin with a model of named effects."""


def test_a_fact_about_effects_stands_in_their_rows() -> None:
    """No list of effects outside the catalogue: it would be forgotten when an effect is added."""
    names = {name for _, name in CATALOGUE} - QUANTITIES.keys() - {"inertia"}
    for path in modules():
        if path.parent.name in ("effects", "rig") or str(path.relative_to(PACKAGE)) in BEGINNINGS:
            continue
        for node in ast.walk(tree(path)):
            words = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else []
            words = [*words, *(key for key in node.keys if key)] if isinstance(node, ast.Dict) else words
            listed = {word.value for word in words if isinstance(word, ast.Constant)} & names
            assert len(listed) < 2, f"{path.relative_to(PACKAGE)}:{node.lineno} lists {listed}"


def constants() -> list[tuple[Path, str, str]]:
    """Module, name and docstring of every constant that has one."""
    found = []
    for path in modules():
        for node, after in itertools.pairwise(tree(path).body):
            if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(after, ast.Expr):
                text = after.value.value if isinstance(after.value, ast.Constant) else None
                if isinstance(text, str):
                    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                    found.append((path.relative_to(PACKAGE), ast.unparse(target), text))
    return found


def test_a_constant_says_why_in_a_sentence_that_begins_where_sentences_begin() -> None:
    assert len(constants()) > 500
    assert not [(str(path), name) for path, name, text in constants() if text.lstrip()[:1].islower()]


def test_the_page_of_guesses_is_of_this_package() -> None:
    """Written by tools/thresholds.py."""
    page = (PACKAGE.parent / "docs" / "thresholds.md").read_text()
    wanted = {f"`{name.strip('()')}` ({path})" for path, name, text in constants() if "(guess" in text}
    assert {row for row in wanted if row not in page} == set()
    assert page.count("\n| `") == len(wanted)


def test_files_that_the_papers_name_are_there() -> None:
    root = PACKAGE.parent
    rooms = "|".join(MAY_IMPORT)
    for page in (root / "CONTRIBUTING.md", root / "README.md", *sorted((root / "docs").glob("*.md"))):
        for name in re.findall(rf"`(?:edge_daemon/)?((?:{rooms})/\w+\.py)", page.read_text()):
            assert (PACKAGE / name).is_file(), f"{page.name} names {name}"


def test_no_files_import_each_other_in_a_circle() -> None:
    names = {".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path for path in modules()}
    left = {name: imported(path) & names.keys() - {name} for name, path in names.items()}
    while ready := {name for name, others in left.items() if not others & left.keys()}:
        left = {name: others for name, others in left.items() if name not in ready}
    assert set(left) <= WITH_THE_COMPILER


WITH_THE_COMPILER = {"edge_daemon.integrator.compiled", "edge_daemon.integrator.machine_code"}
"""One loads the other where there is no machine code yet, and never the other way round."""


def test_tests_ask_only_for_what_is_public() -> None:
    """Their own attributes and those of named tuples and the interpreter aside."""
    free = {"self._", "cls._", "os._exit"}
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Attribute) and re.match(r"_[a-z]", node.attr) and node.attr not in NAMED_TUPLES:
                read = ast.unparse(node)
                assert read.startswith(tuple(free)), f"{path.name}:{node.lineno} reads {read}"
            if isinstance(node, ast.ImportFrom):
                asked = [row.name for row in node.names if re.match(r"_[a-z]", row.name)]
                assert not asked, f"{path.name}:{node.lineno} imports {asked}"


NAMED_TUPLES = {"_replace", "_asdict", "_fields"}
"""Public in spite of their names."""

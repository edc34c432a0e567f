"""Writes requirements.lock and requirements-dev.lock from what is installed in this environment.

Each version comes with the checksums of all its files, for every platform, as the registry tells them: pip then takes
no other file. Run after an upgrade that passed ./tools/test:  .venv/bin/python tools/lock.py UV
UV is the program `uv` in an environment of its own (`python3 -m venv E; E/bin/pip install uv; E/bin/uv`).
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent
HEAD = "# Exact versions that were tested together, and their checksums; tools/bootstrap installs them.\n"


def wanted(requirement: Requirement, extras: set[str]) -> bool:
    """Whether the marker holds here, for the asked extras."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({"extra": extra}) for extra in {"", *extras})


def closure(requirements: list[str]) -> dict[str, str]:
    """Name -> installed version of everything these requirements bring in."""
    versions: dict[str, str] = {}
    seen: set[tuple[str, tuple[str, ...]]] = set()
    todo = [Requirement(text) for text in requirements]
    while todo:
        requirement = todo.pop()
        name = re.sub(r"[-_.]+", "-", requirement.name).lower()
        key = (name, tuple(sorted(requirement.extras)))
        if key in seen:
            continue
        seen.add(key)
        found = distribution(name)
        versions[name] = found.version
        needs = [Requirement(text) for text in found.requires or []]
        todo += [need for need in needs if wanted(need, requirement.extras)]
    return versions


def with_checksums(uv: str, versions: dict[str, str]) -> str:
    """The lines of a lock file."""
    rows = "".join(f"{name}=={version}\n" for name, version in sorted(versions.items()))
    words = [uv, "pip", "compile", "-", "-q", "--no-deps", "--generate-hashes", "--no-header", "--no-annotate"]
    words += ["--universal", "--python-version", "3.11"]
    return subprocess.run(words, input=rows, text=True, capture_output=True, check=True).stdout


def main(uv: str) -> None:
    """Write both files."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    runtime = project["dependencies"]
    for file, requirements in (
        ("requirements.lock", runtime),
        ("requirements-dev.lock", runtime + project["optional-dependencies"]["dev"]),
    ):
        (ROOT / file).write_text(HEAD + with_checksums(uv, closure(requirements)))


if __name__ == "__main__":
    main(*sys.argv[1:])

"""A bill of materials in CycloneDX's JSON format, version 1.5, of what `requirements.lock` installs.

`sbom.py [FILE]` writes it; without a file to standard output. Run in the environment that was made from the lock.
"""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
LOCK = ROOT / "requirements.lock"


def locked(text: str) -> dict[str, str]:
    """Name -> version of a lock file's lines; checksums follow them."""
    return dict(re.findall(r"^([A-Za-z0-9._-]+)==(\S+)", text, re.MULTILINE))


def component(name: str, version: str) -> dict[str, Any]:
    """One library, with what it says of its licence."""
    row: dict[str, Any] = {"type": "library", "name": name, "version": version, "purl": f"pkg:pypi/{name}@{version}"}
    try:
        told = metadata(name)
    except PackageNotFoundError:
        return row
    licence = told.get("License-Expression") or next(
        (word.rpartition(" :: ")[2] for word in told.get_all("Classifier", []) if word.startswith("License ::")), None
    )
    return {**row, "licenses": [{"license": {"name": licence}}]} if licence else row


def bill(lock: str, version: str) -> dict[str, Any]:
    """The whole document; the same lock gives the same bytes."""
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": {"type": "application", "name": "edge-daemon", "version": version}},
        "components": [component(name, number) for name, number in sorted(locked(lock).items())],
    }


def main(arguments: list[str]) -> None:
    """Write the bill of materials."""
    sys.path.insert(0, str(ROOT))
    from edge_daemon import __version__

    text = json.dumps(bill(LOCK.read_text(), __version__), indent=2) + "\n"
    if arguments:
        Path(arguments[0]).write_text(text)
    else:
        print(text, end="")


if __name__ == "__main__":
    main(sys.argv[1:])

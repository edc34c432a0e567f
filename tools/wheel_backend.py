"""Builds as setuptools does, with the page's chart library fetched first, so that a wheel serves the page by itself."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403  (the hooks that stay as they are)


def build_wheel(*arguments: Any, **options: Any) -> str:
    """The name of the wheel."""
    subprocess.run([str(Path(__file__).parent / "charts")], check=False)
    return str(build_meta.build_wheel(*arguments, **options))

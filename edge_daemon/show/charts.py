"""Where the page's chart library is: uPlot (MIT licence), put here by `tools/charts`, served as it came."""

from __future__ import annotations

from pathlib import Path

FILES = {
    "/charts/uPlot.js": ("uPlot.iife.min.js", "text/javascript"),
    "/charts/uPlot.css": ("uPlot.min.css", "text/css"),
    "/charts/LICENSE": ("LICENSE", "text/plain"),
}
"""Each address has a file and a content type."""


def folder() -> Path:
    """Where the library is installed, if it is."""
    return Path(__file__).parent / "uplot"


def read(address: str) -> tuple[bytes, str] | None:
    """Content and content type of one file of the library; None where it is not installed."""
    name, kind = FILES[address]
    try:
        return (folder() / name).read_bytes(), kind
    except OSError:
        return None

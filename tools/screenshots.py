"""The pictures under docs/: one drive and Compare, as a real browser shows them on a simulated drive.

    ./tools/screenshots

Needs Debian's chromium and chromium-driver.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "show")]

from browser import Browser, browsing, gateway  # noqa: E402

DOCS = ROOT / "docs"
SETTLED_S, FOUND_S = 60.0, 90.0
"""Limits for the plots of a drive to be drawn, and for a diagnosis on two busy cores."""
WIDTH_PX, DRIVE_HEIGHT_PX, COMPARE_HEIGHT_PX = 1200, 1300, 1500
DATA_S = 20.0
"""Stored motion that the diagnosis is given at least."""


def shot(browser: Browser, name: str, height_px: int) -> None:
    """One picture of the view as it is, under docs/."""
    browser.driver.set_window_size(WIDTH_PX, height_px)
    browser.driver.save_screenshot(str(DOCS / f"{name}.png"))
    print(DOCS / f"{name}.png")


def main() -> None:
    """Both pictures."""
    with tempfile.TemporaryDirectory() as folder, gateway(Path(folder)) as site, browsing() as browser:
        browser.driver.set_window_size(WIDTH_PX, DRIVE_HEIGHT_PX)
        browser.go(site.port, "drive/axis-1")
        browser.wait("the loop", lambda: browser.inked("#plot-loop") > 2000, SETTLED_S)
        browser.go(site.port, "compare/axis-1")
        browser.wait("data", lambda: float(browser.one("#now").text.split()[1]) > DATA_S, SETTLED_S)
        browser.one("#go").click()
        browser.wait("a verdict", lambda: browser.texts("#verdict")[0], FOUND_S)
        shot(browser, "compare", COMPARE_HEIGHT_PX)
        browser.go(site.port, "drive/axis-1")
        browser.wait("the loop", lambda: browser.inked("#plot-loop") > 2000, SETTLED_S)
        shot(browser, "drive", DRIVE_HEIGHT_PX)


if __name__ == "__main__":
    main()

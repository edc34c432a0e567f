"""The pictures under docs/: every view as a real browser shows it on a simulated drive; laptop, phone and dark.

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
SETTLED_S, FOUND_S = 150.0, 400.0
"""Limits for the plots of a drive to be drawn, and for a diagnosis on two cores that others use."""
LAPTOP_PX, PHONE_PX = 1366, 390
DATA_S = 20.0
"""Stored motion that the diagnosis is given at least."""


def shot(browser: Browser, name: str, *, dark: bool = False, width_px: int = LAPTOP_PX) -> None:
    """One picture of the whole view as it is, under docs/."""
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    for height_px in (900, None):  # the height is known when the width is
        found = int(browser.driver.execute_script("return document.documentElement.scrollHeight"))
        size = {"width": width_px, "height": height_px or found, "deviceScaleFactor": 1, "mobile": width_px == PHONE_PX}
        browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.driver.execute_async_script("setTimeout(arguments[0], 700)")
    browser.driver.save_screenshot(str(DOCS / f"{name}.png"))
    print(DOCS / f"{name}.png")


def main() -> None:
    """All pictures."""
    with tempfile.TemporaryDirectory() as folder, gateway(Path(folder)) as site, browsing() as browser:
        browser.go(site.port, "drive/axis-1")
        browser.wait("the loop", lambda: browser.inked("#plot-loop") > 2000, SETTLED_S)
        browser.wait("data", lambda: float(browser.one("#now").text.split()[1]) > DATA_S, SETTLED_S)
        shot(browser, "drive")
        shot(browser, "drive-dark", dark=True)
        shot(browser, "drive-phone", width_px=PHONE_PX)
        browser.go(site.port, "compare/axis-1/find")
        browser.wait("a verdict", lambda: browser.texts("#verdict")[0], FOUND_S)
        shot(browser, "compare")
        for view in ("life", "events"):
            browser.go(site.port, f"{view}/axis-1")
            browser.wait("the view", lambda: browser.texts("#answer .verdict, #events tbody tr")[0], SETTLED_S)
            shot(browser, view)


if __name__ == "__main__":
    main()

"""The pictures under docs/: every view as a real browser shows it on a laptop, on a phone and in the dark.

    ./tools/screenshots

Needs Debian's chromium and chromium-driver.
"""

from __future__ import annotations

import base64
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "show")]

from browser import Browser, Gateway, browsing, fed_page, gateway  # noqa: E402

DOCS = ROOT / "docs"
FORMS = {"laptop": "", "dark": "-dark", "phone": "-phone"}
"""How a view is seen, and what that adds to the name of its picture."""
SETTLED_S, FOUND_S = 150.0, 400.0
"""Limits for the plots of a drive to be drawn, and for a diagnosis on two cores that others use."""
DATA_S = 20.0
"""Stored motion that the diagnosis is given at least."""
DRIVES = 12
"""Enough for a list that is sorted by worst, few enough to be read."""
LONGEST_PX = 2600
"""A picture ends here; what is below is more of the same."""
QUALITY = 82
"""Of WebP, in percent: text stays sharp, and a view takes some 60 kB."""


def shot(browser: Browser, view: str) -> None:
    """The view as it is, in all forms, under docs/."""
    for form, ending in FORMS.items():
        with browser.seen_as(form):
            browser.settle()
            height = int(browser.driver.execute_script("return document.documentElement.scrollHeight"))
        with browser.seen_as(form, min(height, LONGEST_PX)):
            browser.settle()
            found = browser.driver.execute_cdp_cmd("Page.captureScreenshot", {"format": "webp", "quality": QUALITY})
        file = DOCS / f"{view}{ending}.webp"
        file.write_bytes(base64.b64decode(found["data"]))
        print(f"{file}  {file.stat().st_size / 1000:.0f} kB", flush=True)


def one_drive(browser: Browser, site: Gateway) -> None:
    """The views of a simulated drive whose model lacks its dry friction."""
    browser.go(site.port, "drive/axis-1")
    browser.wait("the loop", lambda: browser.inked("#plot-loop") > 2000, SETTLED_S)
    browser.wait("data", lambda: float(browser.one("#now").text.split()[1]) > DATA_S, SETTLED_S)
    shot(browser, "drive")
    browser.go(site.port, "compare/axis-1/find")
    browser.wait("a verdict", lambda: browser.texts("#verdict")[0], FOUND_S)
    shot(browser, "compare")
    for view in ("life", "events"):
        browser.go(site.port, f"{view}/axis-1")
        browser.wait("the view", lambda: browser.texts("#answer .verdict, #events tbody tr")[0], SETTLED_S)
        shot(browser, view)


def many_drives(browser: Browser, folder: Path) -> None:
    """The list, worst first."""
    with fed_page(folder, DRIVES) as port:
        browser.go(port)
        browser.wait("all drives", lambda: len(browser.texts("#overview tbody th")) == DRIVES)
        shot(browser, "overview")


def report(browser: Browser, folder: Path) -> None:
    """What is put before a customer."""
    record, model, file = (str(folder / name) for name in ("gear.csv", "gear.toml", "gear.html"))
    for words in (
        ["simulate", "--effect", "coulomb_friction", "--out", record, "--model", model],
        ["diagnose", record, "--model", model, "--report", file],
    ):
        subprocess.run([sys.executable, "-m", "edge_daemon", *words], cwd=ROOT, check=True, capture_output=True)
    browser.driver.get(Path(file).as_uri())
    shot(browser, "report")


def main() -> None:
    """All pictures."""
    with tempfile.TemporaryDirectory() as folder, browsing() as browser:
        report(browser, Path(folder))
        many_drives(browser, Path(folder))
        with gateway(Path(folder)) as site:
            one_drive(browser, site)


if __name__ == "__main__":
    main()

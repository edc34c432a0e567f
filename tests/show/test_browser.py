"""The page in a real browser, on live data from the simulated drive. Screenshots: build/screenshots."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from edge_daemon.show import charts

pytest.importorskip("selenium")
from browser import CHROMIUM, DRIVER, Browser, Gateway, browsing, fed_page, gateway

pytestmark = [
    pytest.mark.timeout(400),
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="needs chromium and chromium-driver (apt install both)"),
]
needs_charts = pytest.mark.skipif(not (charts.folder() / "version").exists(), reason="needs uPlot: run tools/charts")

DRIVE = "axis-1"
WITHIN_OF_TRUE = 1.3
JOB_WITHIN_S = 150.0
"""bound of a wait for a child process; an idle machine needs a tenth"""
PHONE_SCREENS = 3
"""A phone scrolls so often to the end of a drive's view."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    with gateway(tmp_path_factory.mktemp("page")) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with browsing() as found:
        yield found


@pytest.fixture(autouse=True)
def quiet_and_at_home(browser: Browser) -> Iterator[None]:
    """After each test: the console is silent, and no request has left the machine."""
    yield
    assert browser.complaints() == []
    assert browser.hosts() <= {"127.0.0.1"}


def state_of(browser: Browser) -> str:
    """What the drive's view says at its top."""
    return str(browser.one(".state").get_attribute("data-state"))


def unfolded(browser: Browser, drive: str = DRIVE) -> None:
    """The drive's view with nothing hidden."""
    if not browser.driver.current_url.endswith(f"drive/{drive}"):
        browser.driver.execute_script(f"location.hash = '#/drive/{drive}'")
    browser.wait("the view", lambda: browser.one("#more"))
    browser.driver.execute_script("document.querySelectorAll('.drive > details').forEach((part) => (part.open = true))")


def test_one_drive_is_seen_at_once_with_why_and_what_to_do(browser: Browser, site: Gateway) -> None:
    """The simulated gear has dry friction, of which the model knows nothing."""
    browser.go(site.port, "")
    browser.wait("the only drive", lambda: browser.driver.current_url.endswith(f"#/drive/{DRIVE}"))
    browser.wait("what is wrong", lambda: "sensor noise alone" in browser.one(".state").text)
    assert browser.texts(".state b")[0].startswith("Works, but"), "its model does not fit, or worse on a busy computer"
    assert browser.texts(".state .button") == ["Find what is missing"]
    big = browser.wait("four answers", lambda: _known(browser.texts(".question .big")))
    assert 1e3 * float(big[0].split()[0]) == pytest.approx(1e5, rel=0.1), "the simulated gear's stiffness"
    assert float(big[2].split()[0]) > 3.0 and "times sensor noise" in big[2]
    browser.shoot("drive")


def _known(big: list[str]) -> list[str]:
    return big if len(big) == 4 and not any(text.startswith("–") for text in big) else []


@needs_charts
@pytest.mark.parametrize("plot", ["noise", "loop", "load", "error", "stiffness", "life", "ratio", "torque", "level"])
def test_each_plot_is_drawn_with_units_and_a_verdict(browser: Browser, site: Gateway, plot: str) -> None:
    unfolded(browser)
    browser.wait(f"{plot} drawn", lambda: browser.inked(f"#plot-{plot}") > 2000)
    words = f"""return ["#plot-{plot} .verdict", "#plot-{plot} .chart"].map((part) => document.querySelector(part))
        .map((node) => node.ariaLabel || node.textContent)"""
    verdict, label = browser.wait(f"{plot} verdict", lambda: browser.driver.execute_script(words))
    assert len(verdict) > 10 and "NaN" not in verdict and "undefined" not in verdict
    assert label.endswith(verdict)


def test_every_plot_is_a_table_too(browser: Browser, site: Gateway) -> None:
    unfolded(browser)
    browser.driver.execute_script("document.querySelector('#plot-noise summary').click()")
    rows = browser.wait("the table", lambda: browser.texts("#plot-noise details tbody tr"))
    assert 10 < len(rows) <= 40
    assert browser.texts("#plot-noise details thead th")[0] == "frequency [Hz]"
    browser.driver.execute_script("document.querySelector('#plot-noise summary').click()")
    stiffness = browser.wait(
        "numbers", lambda: [row for row in browser.texts("#all tbody tr") if re.match(r"stiffness \d", row)]
    )
    assert float(stiffness[0].split()[1]) == pytest.approx(1e5, rel=0.1)


def test_what_is_missing_is_found_added_and_the_live_error_falls(browser: Browser, site: Gateway) -> None:
    """Two clicks: the button at the top of the drive, and Add beside the first line."""
    browser.go(site.port, f"drive/{DRIVE}")
    browser.wait("enough data", lambda: _stored_s(browser) > 12.0)
    browser.wait("the button", lambda: browser.one(".state .button").click() or True)
    before = browser.wait("a live error", lambda: float(browser.one("#live-error").get_attribute("data-value")))
    verdict = browser.wait("a verdict", lambda: browser.texts("#verdict"), JOB_WITHIN_S)
    assert browser.one("#verdict").get_attribute("data-verdict") == "missing", verdict
    first = float(browser.one("#verdict").get_attribute("data-nrmse"))
    names = browser.texts("#found tbody th")
    assert "friction" in names[0], names
    browser.shoot("compared")
    (taken,) = site.scratch.glob("edge-daemon-page-*/axis-1.parquet")
    recording = shutil.copy(taken, site.folder / "compared.parquet")  # the page looks again after adding
    browser.one("button.add").click()
    browser.wait("the result", lambda: browser.texts("#note")[0].startswith("Added"), JOB_WITHIN_S)
    after = float(browser.one("#note").get_attribute("data-after"))
    assert after < 0.15 * first
    assert after <= WITHIN_OF_TRUE * true_error(site, recording)
    assert browser.wait("the growth", lambda: browser.one("#plot-lineage").get_attribute("data-versions")) == "2"
    browser.wait(
        "a live error that fell",
        lambda: 0 < float(browser.one("#live-error").get_attribute("data-value")) < 0.3 * before,
    )
    browser.wait(
        "a second look",
        lambda: browser.one("#verdict").get_attribute("data-nrmse") and not browser.one("#work").is_displayed(),
        JOB_WITHIN_S,
    )
    browser.shoot("added")


def true_error(site: Gateway, recording: Path) -> float:
    """Held-out error of the model that has what the simulated gear has, on the very recording the page took."""
    assert set(site.truth["effects"]) == {"kinematic_error", "coulomb_friction"}
    model = site.folder / "true.toml"
    head = '[joint]\nbalance = "torsion"\nratio = 100.0\noutput_inertia_kg_m2 = 0.05\n'
    names = ("linear_stiffness", "viscous_damping", "kinematic_error", "coulomb_friction")
    model.write_text(head + "".join(f'[[effect]]\nname = "{name}"\n' for name in names))
    command = [sys.executable, "-m", "edge_daemon", "compare", str(recording), "--model", str(model), "--json", "-"]
    done = subprocess.run(command, capture_output=True, check=True, timeout=JOB_WITHIN_S)
    return float(json.loads(done.stdout)["error"]["nrmse"])


def _stored_s(browser: Browser) -> float:
    """For how long the daemon has been up, as the page says it."""
    return float(browser.one("#now").text.split()[1])


def test_a_formula_is_tried_without_changing_the_model_and_a_bad_one_is_refused(
    browser: Browser, site: Gateway
) -> None:
    before = site.model.read_bytes()
    if f"compare/{DRIVE}" not in browser.driver.current_url:
        browser.go(site.port, f"compare/{DRIVE}")
    browser.wait("no work", lambda: not browser.one("#work").is_displayed())
    field = browser.one("#own-formula")
    field.send_keys("a * sin(theta_in_rad)")
    browser.one("#own-try").click()
    browser.wait("the trial", lambda: browser.texts("#note")[0].startswith("Tried my_effect"), JOB_WITHIN_S)
    tried = browser.wait("it among the versions", lambda: browser.texts("#versions tbody th")[-1])
    assert tried == "tried: with my_effect = a * sin(theta_in_rad)"
    field.clear()
    field.send_keys("a * __import__('os')")
    browser.wait("the refusal, before anything is pressed", lambda: "not allowed" in browser.one("#formula-word").text)
    assert browser.one("#formula-word").text.startswith("From letter 5 on")
    browser.one("#own-try").click()
    browser.wait(
        "a refusal",
        lambda: "__import__" in browser.texts("#note")[0] or "expression" in browser.texts("#note")[0],
        JOB_WITHIN_S,
    )
    assert site.model.read_bytes() == before


def test_a_formula_is_completed_by_keyboard_and_judged_as_it_is_written(browser: Browser, site: Gateway) -> None:
    from selenium.webdriver.common.keys import Keys

    if f"compare/{DRIVE}" not in browser.driver.current_url:
        browser.go(site.port, f"compare/{DRIVE}")
    assert "none of them" not in browser.texts("#found > p.quiet"), "before anything was compared"
    field, word = browser.one("#own-formula"), lambda: browser.one("#formula-word").text
    field.clear()
    field.send_keys("a *")
    browser.wait("an end too early", lambda: "ends too early" in word())
    field.send_keys(" tan")
    browser.wait("names", lambda: browser.texts("#names li") == ["tanh"])
    field.send_keys(Keys.TAB)
    field.send_keys("velo")
    browser.wait("the channel", lambda: browser.texts("#names li") == ["velocity_out_rad_s"])
    assert barriers(browser) == []
    browser.shoot("formula")
    field.send_keys(Keys.ARROW_DOWN, Keys.ENTER)
    assert field.get_attribute("value") == "a * tanh(velocity_out_rad_s"
    browser.wait("the bracket", lambda: "never closed" in word())
    field.send_keys(" / w)")
    browser.wait("what would be fitted", lambda: word() == "Would be fitted: a and, searched for, w.")
    field.send_keys(" * theta_in")
    browser.wait("what was meant", lambda: "the channel is called theta_in_rad" in word())
    field.clear()


def test_a_version_gets_a_name_is_compared_and_put_back(browser: Browser, site: Gateway) -> None:
    """After the friction was added: the model as it was begun stands beside it, and comes back."""
    if f"compare/{DRIVE}" not in browser.driver.current_url:
        browser.go(site.port, f"compare/{DRIVE}")
    if "friction" not in site.model.read_text():
        pytest.skip("nothing was added")
    browser.wait("no work", lambda: not browser.one("#work").is_displayed() and browser.texts("#versions tbody th"))
    browser.one("#version-name").send_keys("with friction")
    browser.one("#name-version").click()
    browser.wait("the name", lambda: "with friction" in browser.texts("#versions tbody th"))
    browser.wait("data that were compared", lambda: _looked(browser), JOB_WITHIN_S)
    titles = browser.texts("#versions tbody th")
    boxes = browser.driver.find_elements("css selector", "#versions .pick")
    assert [box.get_attribute("aria-label") for box in boxes] == [f"Compare version {title}" for title in titles[:3]]
    for box in (boxes[1], boxes[2]):
        box.click()
    browser.one("#between").click()
    errors = browser.wait("both", lambda: browser.texts("#side-by-side tbody tr:first-child td"), JOB_WITHIN_S)
    named, begun = (float(text.split()[0]) for text in errors)
    assert named < 0.3 * begun
    browser.shoot("versions")
    assert barriers(browser) == []
    whole = site.model.read_bytes()
    _press(browser, "Put version before: ")
    browser.wait("it back", lambda: browser.texts("#note")[0].startswith("Put back"))
    assert "friction" not in site.model.read_text()
    _press(browser, "Put version with friction back")
    browser.wait("the named", lambda: "Put back: with friction" in browser.texts("#note")[0])
    assert site.model.read_bytes() == whole
    _press(browser, "Forget version with friction")
    browser.wait("it gone", lambda: "with friction" not in browser.texts("#versions tbody th"))
    for _ in range(2):
        browser.wait("undo", lambda: browser.one("#undo").click() or True)
        browser.wait("one step back", lambda: browser.texts("#note")[0].startswith("Taken back: put back"))
        browser.driver.execute_script("document.getElementById('note').textContent = ''")
    assert site.model.read_bytes() == whole


def _looked(browser: Browser) -> bool:
    """Whether a comparison is shown; one is begun where none is."""
    if browser.texts("#verdict"):
        return not browser.one("#work").is_displayed()
    if browser.one("#go").is_enabled():
        browser.one("#go").click()
    return False


def _press(browser: Browser, label: str) -> None:
    button = f'#versions button[aria-label^="{label}"]'
    browser.wait(label, lambda: browser.one(button).click() or True)  # the list may be drawn anew just now


def test_a_recording_is_uploaded_and_a_stretch_of_stored_data_chosen(
    browser: Browser, site: Gateway, tmp_path: Path
) -> None:
    from selenium.webdriver.support.ui import Select

    if f"compare/{DRIVE}" not in browser.driver.current_url:
        browser.go(site.port, f"compare/{DRIVE}")
    browser.wait("no work", lambda: not browser.one("#work").is_displayed() and browser.texts("#data option"))
    mine = tmp_path / "mine.csv"
    mine.write_text("0,0,0\n1,90,0.9\n2,180,1.8\n")
    browser.one("#file").send_keys(str(mine))
    browser.wait("the upload", lambda: browser.texts("#note")[0].startswith("mine.csv is uploaded"))
    assert browser.one("#data").get_attribute("value") == "file:mine.csv"
    browser.wait("its columns", lambda: len(browser.texts("#columns tbody tr")) == 3)
    for row, (channel, unit) in enumerate([("time_s", "ms"), ("theta_in_rad", "deg"), ("theta_out_rad", "deg")]):
        what, of = browser.driver.find_elements("css selector", "#columns select")[2 * row : 2 * row + 2]
        Select(what).select_by_value(channel)
        Select(of).select_by_value(unit)
    assert barriers(browser) == []
    browser.shoot("columns")
    browser.one("#use-columns").click()
    browser.wait("the answer", lambda: not browser.one("#columns").is_displayed())
    kept = (site.folder / "uploads" / "mine.csv.columns.toml").read_text()
    assert '"column_1*0.001"' in kept and '"column_2*deg"' in kept
    (tmp_path / "other.csv").write_bytes(b"\x00\x01")
    browser.one("#file").send_keys(str(tmp_path / "other.csv"))
    browser.wait("a refusal", lambda: "rows of numbers" in browser.texts("#note")[0])
    assert "400 (Bad Request)" in "".join(browser.complaints())
    Select(browser.one("#data")).select_by_value("part:")
    browser.wait("the load to choose from", lambda: browser.inked("#plot-past") > 500)
    assert browser.one("#from").get_attribute("value") and browser.one("#length").get_attribute("value") == "20"
    browser.shoot("stretch")
    assert barriers(browser) == []


def test_from_a_robots_bare_file_to_a_verdict_in_six_clicks(browser: Browser, site: Gateway, tmp_path: Path) -> None:
    """Milliseconds, degrees, a motor that counts the other way, no header: as a robot's logger writes it."""
    raw = tmp_path / "robot.csv"
    record = tmp_path / "simulated.csv"
    words = ["simulate", "--effect", "coulomb_friction", "--seconds", "10", "--out", str(record)]
    subprocess.run([sys.executable, "-m", "edge_daemon", *words], check=True, capture_output=True, timeout=JOB_WITHIN_S)
    with record.open() as file, raw.open("w") as out:
        for row in csv.DictReader(file):
            motor, output = (math.degrees(float(row[name])) for name in ("theta_in_rad", "theta_out_rad"))
            out.write(f"{1e3 * float(row['time_s']):.3f},{row['temperature_degC']},{output!r},{-motor!r}\n")
    clicks = 0
    browser.driver.get("about:blank")
    browser.go(site.port, f"drive/{DRIVE}")
    browser.wait("the view", lambda: browser.one("nav a[href*=compare]").click() or True)
    clicks += 1
    browser.wait("a place for it", lambda: browser.one("#file").send_keys(str(raw)) is None)
    clicks += 2  # the dialogue of the system, and the file in it
    browser.wait("its columns", lambda: len(browser.texts("#columns tbody tr")) == 4)
    browser.shoot("robot-file")
    browser.one("#use-columns").click()
    browser.wait("the answer", lambda: not browser.one("#columns").is_displayed())
    browser.one("#go").click()
    clicks += 2
    verdict = browser.wait("a verdict", lambda: browser.texts("#verdict"), JOB_WITHIN_S)
    known = "friction" in site.model.read_text()
    assert browser.one("#verdict").get_attribute("data-verdict") == ("adequate" if known else "missing"), verdict
    assert clicks <= 6
    browser.shoot("robot-verdict")


def test_a_change_is_taken_back(browser: Browser, site: Gateway) -> None:
    if f"compare/{DRIVE}" not in browser.driver.current_url:
        browser.go(site.port, f"compare/{DRIVE}")
    if "friction" not in site.model.read_text():
        pytest.skip("nothing was added")
    browser.wait("undo", lambda: browser.one("#undo").is_enabled())
    browser.one("#undo").click()
    browser.wait("the note", lambda: browser.texts("#note")[0].startswith("Taken back"))
    assert "friction" not in site.model.read_text()


def test_life_answers_what_if_and_more_load_costs_life(browser: Browser, site: Gateway) -> None:
    browser.go(site.port, f"life/{DRIVE}")
    plain = browser.wait("an answer", lambda: browser.texts("#answer .verdict")[0])
    field = browser.one("#factor")
    field.clear()
    field.send_keys("2")
    browser.one("#ask").click()
    heavy = browser.wait("another answer", lambda: _other(browser.texts("#answer .verdict")[0], plain))
    assert _p10(heavy) < 0.3 * _p10(plain)
    browser.shoot("life")


def _other(text: str, than: str) -> str:
    return text if text != than else ""


def _p10(text: str) -> float:
    return float(text.split("longer than ")[1].split()[0])


def test_events_are_listed_newest_first(browser: Browser, site: Gateway) -> None:
    browser.go(site.port, "events")
    browser.wait("events", lambda: browser.texts("#events tbody tr"))

    def first_event() -> bool:
        browser.driver.execute_script("document.getElementById('more')?.click()")
        return any("measuring" in row for row in browser.texts("#events tbody tr"))

    browser.wait("the event that began it", first_event)
    times = browser.texts("#events tbody th")
    assert times == sorted(times, reverse=True)
    browser.driver.execute_script(
        "const f = document.getElementById('severity'); f.value = 4; f.dispatchEvent(new Event('change'))"
    )
    assert all("failure" in row for row in browser.texts("#events tbody tr"))
    browser.shoot("events")


def test_events_of_one_trouble_are_one_row(browser: Browser, fed: int) -> None:
    """Grouped by the page's own module: a trouble that came back, one that lasts, and what is none."""
    hot, cut = "housing at {} degC: lower the load", "channel theta_in_rad: 50% of its samples cannot be used: check it"
    happened = [
        (0.0, "a", 0, "daemon", "measuring"),
        (10.0, "a", 2, "temperature", hot.format(85)),
        (20.0, "b", 2, "temperature", hot.format(90)),
        (70.0, "a", 0, "temperature", f"cleared: {hot.format(79)}"),
        (100.0, "a", 2, "temperature", f"{hot.format(88)} (again)"),
        (130.0, "a", 0, "temperature", f"cleared: {hot.format(78)}"),
        (200.0, "a", 3, "channel theta_in_rad", cut),
        (5000.0, "a", 2, "temperature", hot.format(86)),
    ]
    names = ("time_s", "drive", "rank", "source", "message")
    events = [dict(zip(names, row, strict=True)) for row in reversed(happened)]
    browser.go(fed, "events")
    script = "import('/events.js').then((m) => arguments[1](m.grouped(arguments[0])))"
    rows = browser.driver.execute_async_script(script, events)
    found = [(row["begin_s"], row["end_s"], row["drive"], row["rank"], row["times"]) for row in rows]
    assert found == [
        (5000, None, "a", 2, 1), (200, None, "a", 3, 1), (20, None, "b", 2, 1), (10, 130, "a", 2, 2), (0, 0, "a", 0, 1),
    ]  # fmt: skip


def test_keyboard_alone_reaches_the_views(browser: Browser, site: Gateway) -> None:
    from selenium.webdriver.common.keys import Keys

    browser.driver.get("about:blank")
    browser.go(site.port, "events")
    browser.wait("links", lambda: len(browser.texts("nav a")) == 5)
    reached = []
    for _ in range(8):
        browser.driver.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(browser.driver.switch_to.active_element.text)
    assert {"Live", "Compare", "Life", "Events", "Tables"} <= set(reached)


def test_a_phone_shows_everything_without_scrolling_sideways(browser: Browser, site: Gateway) -> None:
    browser.driver.set_window_size(500, 900)
    try:
        browser.go(site.port, f"drive/{DRIVE}")
        browser.wait("a state", lambda: state_of(browser) not in ("starting", "None"))
        width = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        assert browser.driver.execute_script(width) == 0
        assert browser.driver.execute_script("return document.documentElement.scrollHeight") < PHONE_SCREENS * 900
        browser.shoot("phone")
    finally:
        browser.driver.set_window_size(1280, 1800)


def test_the_page_says_when_the_gateway_is_away_and_comes_back_by_itself(browser: Browser, site: Gateway) -> None:
    browser.go(site.port, f"drive/{DRIVE}")
    browser.wait("a state", lambda: browser.texts(".state b") and browser.texts("#now")[0])
    site.stop()
    browser.wait("a warning", lambda: browser.one("#contact").is_displayed())
    browser.shoot("away")
    site.start()
    browser.wait("contact again", lambda: not browser.one("#contact").is_displayed())
    browser.wait("fresh data", lambda: state_of(browser) not in ("starting", "no data"))


@pytest.fixture(scope="module")
def fed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    with fed_page(tmp_path_factory.mktemp("fed"), 50) as port:
        yield port


def test_fifty_drives_are_sorted_by_worst_and_a_full_disk_is_told(browser: Browser, fed: int) -> None:
    browser.go(fed)
    names = browser.wait("fifty drives", lambda: _all(browser.texts("#overview tbody th"), 50))
    assert names[:2] == ["d3", "d0"], "without data, then out of specification"
    browser.wait("the verdict", lambda: "of 50 drives need attention" in browser.texts("#verdict")[0])
    assert browser.texts("#verdict")[0].endswith("the worst first: d3.")
    trouble = browser.one("#troubles").text
    assert "no space left" in trouble and "max_mib" in trouble
    browser.shoot("fifty")


def _all(found: list[str], count: int) -> list[str]:
    return found if len(found) == count else []


def test_one_alarm_is_acknowledged_and_the_log_says_by_whom(browser: Browser, fed: int) -> None:
    browser.go(fed, "drive/d0")
    buttons = browser.wait("two alarms", lambda: _all(browser.texts(".alarm button"), 2))
    assert buttons == ["Acknowledge", "Acknowledge"]
    browser.one("#who").send_keys("Ida")
    browser.driver.find_elements("css selector", ".alarm button")[1].click()
    browser.wait("one is left", lambda: len(browser.texts(".alarm button")) == 1)
    assert "acknowledged" in browser.texts(".alarm")[1] and "Over, began" in browser.texts(".alarm")[0]
    browser.shoot("alarm")
    assert barriers(browser) == []
    browser.go(fed, "events")
    browser.wait("the log", lambda: "acknowledged by Ida: housing at 85" in browser.texts("#events tbody tr")[0])


@pytest.mark.parametrize(
    ("drive", "plot", "words"),
    [
        ("d1", "loop", "one encoder"),
        ("d1", "load", "one encoder"),
        ("d2", "loop", "channel theta_in_rad is not configured"),
        ("d2", "noise", "[drive.sound]"),
    ],
)
def test_what_a_drive_cannot_show_says_why(browser: Browser, fed: int, drive: str, plot: str, words: str) -> None:
    if not browser.driver.current_url.endswith(f"drive/{drive}"):
        browser.go(fed, f"drive/{drive}")
    unfolded(browser, drive)
    browser.wait("the reason", lambda: words in browser.texts(f"#plot-{plot} .verdict")[0])


def test_the_sound_of_months_is_a_picture_a_table_and_a_verdict(browser: Browser, fed: int) -> None:
    browser.driver.get("about:blank")  # or what another test unfolded counts
    browser.go(fed, "drive/d0")
    asked = "return performance.getEntriesByType('resource').filter((row) => row.name.includes('sound.js')).length"
    browser.wait("the drive", lambda: browser.texts("#sound summary"))
    assert browser.driver.execute_script(asked) == 0, "what nobody unfolded costs no payload"
    browser.one("#sound summary").click()
    told = browser.wait("a verdict", lambda: [row for row in browser.texts("#plot-sound .verdict") if "Hz" in row])
    assert "+12.0 ± 0.4 dB around 403 Hz" in told[0] and "export --sound" in told[0]
    browser.wait("a picture", lambda: browser.inked("#plot-sound") > 50_000)
    browser.one("#plot-sound details summary").click()
    rows = browser.wait("the table", lambda: browser.texts("#plot-sound tbody tr"))
    assert len(rows) == 24 and "-60" in rows[0]
    assert barriers(browser) == []
    browser.driver.execute_script(
        "const s = document.getElementById('regime'); s.value = 0; s.dispatchEvent(new Event('change'))"
    )
    browser.wait("another speed", lambda: browser.one("#regime").get_attribute("value") == "0")
    browser.shoot("sound")
    browser.go(fed, "drive/d1")
    browser.one("#sound summary").click()
    browser.wait("why not", lambda: "No sound is kept" in browser.texts("#plot-sound .verdict")[0])


def test_a_lone_line_is_as_bright_as_colours_go(browser: Browser, fed: int) -> None:
    """Noise falls by 60 dB over the band; four more in one band from half time on are a bearing."""
    browser.go(fed, "drive/d0")
    rng = np.random.default_rng(5)
    level = -40.0 - np.arange(64.0) + rng.normal(0.0, 0.5, (120, 64))
    level[60:, 40] += 4.0
    script = """
    const [rows, done] = arguments;
    import("/sound.js")
      .then((it) => done(it.standing(rows)), (error) => done(String(error)));"""
    told = browser.driver.execute_async_script(script, np.round(level, 1).tolist())
    shares = (np.array(told["above_dB"]) - told["low"]) / (told["high"] - told["low"])
    assert np.median(shares[60:, 40]) > 0.75 and np.median(shares) < 0.4 and np.median(shares[:60, 40]) < 0.4


def test_without_a_gear_size_the_life_view_says_what_is_missing(browser: Browser, fed: int) -> None:
    browser.go(fed, "life/d1")
    browser.wait("the reason", lambda: "Without a gear size" in browser.texts("#plot-chance .verdict")[0])
    assert not browser.one("#ask").is_enabled()


def test_a_drive_that_never_delivered_says_what_to_check(browser: Browser, fed: int) -> None:
    browser.go(fed, "drive/d3")
    browser.wait("no data", lambda: browser.texts(".state b") == ["No data"])
    assert "check power, cable and address" in browser.one(".state").text


def test_a_wrong_token_is_said_and_a_changed_one_is_asked_for(browser: Browser, tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("the-first-token-of-this-test")
    with fed_page(tmp_path, 5, token_file=token) as port:
        browser.driver.get(f"http://127.0.0.1:{port}/#/")
        browser.wait("the question", lambda: browser.texts("label[for], form label"))
        field = browser.one("#token")
        field.send_keys("not-the-token-of-this-test")
        browser.one("form button").click()
        browser.wait("a refusal", lambda: browser.texts("[role=alert]") == ["This is not the token."])
        field.clear()
        field.send_keys(token.read_text())
        browser.one("form button").click()
        browser.wait("the drives", lambda: _all(browser.texts("#overview tbody th"), 5))
        assert "edge_daemon" not in browser.driver.execute_script("return document.cookie")
        browser.driver.delete_all_cookies()  # as after a restart with another token
        browser.driver.execute_script("location.hash = '#/events'; location.reload()")
        browser.wait("the question again", lambda: browser.one("#token").is_displayed())
    assert all("401" in row or "403" in row for row in browser.complaints())


@pytest.mark.parametrize("form", ["laptop", "phone", "dark"])
@pytest.mark.parametrize("view", [f"drive/{DRIVE}", f"compare/{DRIVE}", f"life/{DRIVE}", "events"])
def test_axe_finds_no_barrier(browser: Browser, site: Gateway, view: str, form: str) -> None:
    browser.go(site.port, view)
    browser.wait("content", lambda: browser.texts("#title")[0].startswith("bench"))
    with browser.seen_as(form):
        assert barriers(browser) == []


@pytest.mark.parametrize("form", ["laptop", "phone", "dark"])
def test_axe_finds_no_barrier_among_fifty_drives(browser: Browser, fed: int, form: str) -> None:
    browser.go(fed)
    browser.wait("fifty drives", lambda: _all(browser.texts("#overview tbody th"), 50))
    with browser.seen_as(form):
        assert barriers(browser) == []


@pytest.mark.parametrize("form", ["laptop", "phone", "dark"])
def test_axe_finds_no_barrier_in_a_report(browser: Browser, report: Path, form: str) -> None:
    browser.driver.get(report.as_uri())
    with browser.seen_as(form):
        assert barriers(browser) == []


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a simulated gear with an effect that its model lacks."""
    folder = tmp_path_factory.mktemp("report")
    record, model, file = folder / "gear.csv", folder / "model.toml", folder / "report.html"
    for words in (
        ["simulate", "--effect", "coulomb_friction", "--seconds", "10", "--out", str(record), "--model", str(model)],
        ["diagnose", str(record), "--model", str(model), "--report", str(file)],
    ):
        subprocess.run(
            [sys.executable, "-m", "edge_daemon", *words], check=True, capture_output=True, timeout=JOB_WITHIN_S
        )
    return file


def barriers(browser: Browser) -> list[tuple[str, str]]:
    """What axe-core finds on the page as it is."""
    source = pytest.importorskip("axe_core_python").__file__
    browser.driver.execute_script((Path(source).parent / "axe.min.js").read_text())
    found = browser.driver.execute_async_script("axe.run().then(arguments[0])")
    worst = [(row["id"], row["nodes"][0]["html"][:200]) for row in found["violations"]]
    assert found["passes"]
    return worst

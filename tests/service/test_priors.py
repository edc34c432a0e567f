"""What the fleet has taught on its way into a gateway's forecasts: only signed, only newer, only of this gear."""

from __future__ import annotations

import math
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest

from edge_daemon.cli import main
from edge_daemon.config.reading import load
from edge_daemon.config.settings import Drive, Gateway, Zenoh
from edge_daemon.errors import BadInput
from edge_daemon.fleet.prior import FleetPrior
from edge_daemon.fleet.signed import MOST_BYTES, PRIORS, key_from, opened, place_of, signed
from edge_daemon.publish.zenoh_link import ZenohLink
from edge_daemon.service.pipeline import Pipeline, open_pipeline
from edge_daemon.service.priors import DrivePrior, PriorInbox
from edge_daemon.usage.gears import Gear, find_gear
from tests.publish.test_zenoh_link import free_port, peer, until

CONFIG = Path(__file__).parents[2] / "config"
KEY, OTHER = b"k" * 40, b"o" * 40
GEAR = "CSG-20-100"
LIFE_H, SHAPE = 3000.0, 4.0
"""Of the fleet's law at rated torque; its exponent does not matter there."""
pytestmark = pytest.mark.timeout(90)


def taught(number: int = 7, gear: str = GEAR) -> FleetPrior:
    """Gears that live much shorter than the maker says: at rated speed and torque about `LIFE_H`."""
    size = find_gear(gear)
    scale = math.log(LIFE_H * size.rated_speed_rpm / 1000.0)
    return FleetPrior("strainwave/prior", 1, gear, number, 200, 80, [6.0] * 9, [SHAPE] * 9, [scale] * 9)


def envelope(prior: FleetPrior, key: bytes = KEY) -> bytes:
    return signed(prior.to_bytes(), key)


def test_what_was_signed_opens_and_nothing_else_does() -> None:
    whole = envelope(taught())
    assert opened(whole, KEY) == taught()
    with pytest.raises(BadInput, match="not signed with the key of this gateway"):
        opened(whole, OTHER)
    forged = envelope(taught(8), OTHER)
    with pytest.raises(BadInput):
        opened(forged, KEY)
    with pytest.raises(BadInput, match="at most"):
        opened(whole + b" " * MOST_BYTES, KEY)


def test_no_flipped_bit_changes_what_is_believed() -> None:
    """Either refused or, where the JSON around it reads the same, the very prior."""
    whole, rng = envelope(taught()), np.random.default_rng(5)
    for place, bit in zip(rng.integers(0, len(whole), 400), rng.integers(0, 8, 400), strict=True):
        broken = bytearray(whole)
        broken[place] ^= 1 << bit
        try:
            assert opened(bytes(broken), KEY) == taught()
        except BadInput as error:
            assert "\n" not in str(error)


def test_a_short_key_is_refused(tmp_path: Path) -> None:
    (tmp_path / "key").write_text("secret\n")
    with pytest.raises(BadInput, match="6 characters: expected 32 or more"):
        key_from(tmp_path / "key")


def demo_drive(**more: str) -> Drive:
    return msgspec.structs.replace(load(CONFIG / "demo.toml").drive[0], gear=GEAR, **more)


def median_h(pipeline: Pipeline) -> float:
    """Of the remaining life that is forecast now."""
    task = pipeline.due_forecast()
    assert task is not None
    return task().quantile_h(0.5)


def test_a_signed_prior_changes_the_forecast_and_survives_a_restart() -> None:
    """A gear that has not run lives as long as the fleet's law says at rated load, not as the maker's."""
    expected_h = LIFE_H * math.log(2.0) ** (1.0 / SHAPE)
    pipeline, inbox = open_pipeline(demo_drive(), CONFIG, KEY), PriorInbox(KEY)
    makers_h = median_h(pipeline)
    assert not pipeline.take_prior(0.0, inbox) and pipeline.due_forecast() is None
    inbox.hear(envelope(taught()))
    (event,) = pipeline.take_prior(0.0, inbox)
    assert "200 lives of such gears, 80 of them to their end" in event.message
    assert not pipeline.take_prior(1.0, inbox)
    assert median_h(pipeline) == pytest.approx(expected_h, rel=0.15) and makers_h > 2.0 * expected_h
    again = open_pipeline(demo_drive(), CONFIG, KEY)
    assert again.restore(pipeline.state()) == ()
    assert median_h(again) == pytest.approx(expected_h, rel=0.15)


def test_without_the_key_a_kept_prior_is_not_believed_any_more() -> None:
    inbox, before = PriorInbox(KEY), open_pipeline(demo_drive(), CONFIG, KEY)
    inbox.hear(envelope(taught()))
    assert before.take_prior(0.0, inbox)
    for key in (None, OTHER):
        after = open_pipeline(demo_drive(), CONFIG, key)
        assert after.restore(before.state()) == ("prior",)
        assert median_h(after) > 2.0 * LIFE_H


@pytest.mark.parametrize(
    "blob",
    [
        pytest.param(envelope(taught(6)), id="older"),
        pytest.param(envelope(taught(7)), id="the same again"),
        pytest.param(envelope(taught(9), OTHER), id="another key"),
        pytest.param(envelope(taught(9, "CSG-25-100")), id="another gear"),
        pytest.param(b"{}", id="nonsense"),
        pytest.param(b"[" * 5000, id="deep"),
    ],
)
def test_what_is_not_newer_signed_and_of_this_gear_changes_nothing(blob: bytes) -> None:
    inbox, prior = PriorInbox(KEY), DrivePrior(find_gear(GEAR), key=KEY)
    assert prior.offer(envelope(taught(7)), taught(7))
    inbox.hear(blob)
    found = inbox.newest(GEAR)
    assert found is None or not prior.offer(*found)
    assert prior.fleet is not None and prior.fleet.number == 7


def test_a_gateway_without_a_key_takes_none() -> None:
    inbox = PriorInbox(None)
    inbox.hear(envelope(taught()))
    assert inbox.newest(GEAR) is None


def test_a_file_of_the_configuration_stands_above_the_fleet(tmp_path: Path) -> None:
    file = tmp_path / "prior.json"
    file.write_bytes(taught().to_bytes())
    pipeline, inbox = open_pipeline(demo_drive(prior=str(file)), CONFIG, KEY), PriorInbox(KEY)
    assert median_h(pipeline) == pytest.approx(LIFE_H * math.log(2.0) ** (1.0 / SHAPE), rel=0.15)
    inbox.hear(envelope(taught(9)))
    assert not pipeline.take_prior(0.0, inbox)


@pytest.mark.parametrize(
    ("blob", "complaint"),
    [
        (taught(gear="CSG-25-100").to_bytes(), "was learned from gears of CSG-25-100: this is a CSG-20-100"),
        (b"{}", "learned prior"),
        (None, "cannot read"),
    ],
)
def test_a_file_that_is_of_no_use_is_one_line(blob: bytes | None, complaint: str, tmp_path: Path) -> None:
    file = tmp_path / "prior.json"
    if blob is not None:
        file.write_bytes(blob)
    with pytest.raises(BadInput, match=complaint):
        open_pipeline(demo_drive(prior=str(file)), CONFIG)


@contextmanager
def listening(endpoint: str, inbox: PriorInbox) -> Iterator[ZenohLink]:
    settings = Zenoh(mode="client", connect=(endpoint,), listen=())
    link = ZenohLink(settings, Gateway(site="s", name="g"), ("axis-1",), wanted=(f"{PRIORS}/*", inbox.hear))
    link.start()
    try:
        yield link
    finally:
        link.stop(2.0)


@contextmanager
def sharing(endpoint: str, prior: Path, key: Path) -> Iterator[None]:
    words = ["fleet", "share", str(prior), "--connect", endpoint, "--key", str(key), "--seconds", "60"]
    process = subprocess.Popen([sys.executable, "-m", "edge_daemon", *words])
    try:
        yield
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait(5.0)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    prior, key = tmp_path / "prior.json", tmp_path / "fleet.key"
    prior.write_bytes(taught().to_bytes())
    key.write_text(secrets.token_hex(32) + "\n")
    return prior, key


@pytest.mark.parametrize("first", ["gateway", "share"])
def test_a_gateway_hears_the_prior_whoever_comes_first(first: str, files: tuple[Path, Path]) -> None:
    port, inbox = free_port(), PriorInbox(key_from(files[1]))
    endpoint = f"tcp/127.0.0.1:{port}"
    with peer("router", port) as router:
        router.ready()
        if first == "gateway":
            with listening(endpoint, inbox) as link:
                until(lambda: link.health().state == "ok")
                with sharing(endpoint, *files):
                    until(lambda: inbox.newest(GEAR) is not None)
        else:
            with sharing(endpoint, *files), listening(endpoint, inbox):
                until(lambda: inbox.newest(GEAR) is not None)
    found = inbox.newest(GEAR)
    assert found is not None and found[1] == taught()


def test_share_says_what_it_cannot_use(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    prior, key = files
    words = ["fleet", "share", str(prior), "--connect", "tcp/127.0.0.1:1", "--key", str(key), "--seconds", "1"]
    prior.write_text("{}")
    assert main(words) == 2
    key.write_text("short")
    assert main(words) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert "expected what `fleet learn --out` has written" in first and "5 characters" in second


def test_of_a_gear_file_with_slashes_in_its_name_the_key_is_one_word() -> None:
    gear = Gear(name="own/20 #1*", ratio=100.0, rated_torque_Nm=50.0, l10_h=7000.0, l50_h=35000.0)
    word = place_of(gear.name).removeprefix(f"{PRIORS}/")
    assert not set(word) & set("/*#?$")

"""What a shell offers after the first letters, asked of a real bash."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from edge_daemon.cli import main

BASH = shutil.which("bash")


@pytest.mark.skipif(BASH is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["dia"], {"diagnose"}),
        (["check", "--pr"], {"--probe"}),
        (["init", "--motor-"], {"--motor-encoder", "--motor-angle", "--motor-counts"}),
        (["measure", "fre"], {"frequency-response"}),
        (["no-such", "--"], set()),
    ],
)
def test_bash_completes_commands_and_options(
    words: list[str], offered: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion"]) == 0
    script = capsys.readouterr().out
    typed = " ".join(f'"{word}"' for word in ["edge-daemon", *words])
    ask = f"COMP_WORDS=({typed}); COMP_CWORD={len(words)}; _edge_daemon; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run([str(BASH), "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered


@pytest.mark.skipif(shutil.which("man") is None and shutil.which("groff") is None, reason="needs man or groff")
def test_the_manual_page_is_one_that_is_typeset_without_complaint(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "--man"]) == 0
    page = capsys.readouterr().out
    typeset = ["groff", "-man", "-Tutf8", "-ww"] if shutil.which("groff") else ["man", "-l", "-"]
    done = subprocess.run(typeset, input=page, capture_output=True, text=True, check=True)
    assert "--motor-encoder" in done.stdout.replace("\u2010", "-").replace("\u2212", "-") and not done.stderr

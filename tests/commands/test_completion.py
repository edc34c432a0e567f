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

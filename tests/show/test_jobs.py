"""Children of the daemon: whatever they are given, they die and it lives, and says why in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from edge_daemon.errors import BadInput
from edge_daemon.show.jobs import MEMORY_KIB, MOST_CPU_S, Job, Jobs, bounded

SEEN = """
import json, os, resource
limits = [resource.getrlimit(row)[0] for row in (resource.RLIMIT_DATA, resource.RLIMIT_CPU, resource.RLIMIT_CORE)]
print(json.dumps([*limits, os.nice(0), int(open("/proc/self/oom_score_adj").read())]))
"""


def test_a_child_has_a_limit_of_everything_and_the_last_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", os.environ["PATH"].partition(os.pathsep)[2])  # the tests' own come first
    done = subprocess.run(bounded(sys.executable, "-c", SEEN), capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == [MEMORY_KIB * 1024, MOST_CPU_S, 0, 19, 1000]


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("x = bytearray(900 * 2**20)", "MemoryError"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", "SIGKILL ended it: out of memory or time"),
        ("import os; os.abort()", "SIGABRT ended it"),
    ],
)
async def test_a_child_that_takes_too_much_is_one_clear_line(tmp_path: Path, code: str, said: str) -> None:
    jobs = Jobs(tmp_path, tmp_path / "store")
    job = Job(1, "look", "axis-1")
    with pytest.raises(BadInput, match=said) as caught:
        await jobs.output_of(job, bounded(sys.executable, "-c", code))
    assert "\n" not in str(caught.value)


async def test_a_recording_beyond_memory_is_refused_by_the_job_itself(tmp_path: Path) -> None:
    code = (
        "from edge_daemon.service import model_job as job\n"
        "def look(_): raise MemoryError\n"
        "job._look = look\n"
        "raise SystemExit(job.main(['look', '--recording', 'r.csv', '--model', 'm.toml']))"
    )
    with pytest.raises(BadInput, match="more memory is needed than may be had: choose a shorter stretch"):
        await Jobs(tmp_path, tmp_path / "store").output_of(Job(1, "look", "a"), bounded(sys.executable, "-c", code))

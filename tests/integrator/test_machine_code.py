"""The compiled integrator in a file of its own: the daemon simulates without numba."""

import subprocess
import sys

import pytest

from edge_daemon.integrator import machine_code

WITHOUT_NUMBA = """
import sys
import numpy as np
from edge_daemon.integrator import machine_code, twist
push, law = np.sin(np.arange(80) / 9.0), np.array([[0, 0.1, 1e-3, 0, 1.0]])
still = np.zeros(80)
on = twist.Forcing(push, still, still, 0.0, 2.5e-4, 4)
found = twist.simulate(twist.TorsionGear(0.05, 1e5, 20.0, law), on, twist.nothing(law), twist.at_rest(0.0, 0.0, 1, 0))
assert not {"numba", "llvmlite"} & set(sys.modules)
print(*found.ends.tolist())
"""


def ends(code: str) -> list[float]:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return [float(word) for word in done.stdout.split()]


def test_a_file_without_a_compiler_says_what_the_compiler_says():
    if not machine_code.library().exists() and machine_code.make() is None:
        pytest.skip("this system has no linker")
    loaded = WITHOUT_NUMBA.replace("import sys\n", "import sys\nimport edge_daemon.integrator.compiled\n", 1)
    with_numba = loaded.replace("assert not", "assert")
    assert ends(WITHOUT_NUMBA) == pytest.approx(ends(with_numba), rel=1e-12)


def test_what_was_installed_is_taken_before_what_the_service_may_write(tmp_path, monkeypatch):
    """A package brings its machine code: a gateway without a linker would load numba and LLVM at every start."""
    monkeypatch.setattr(machine_code, "__file__", str(tmp_path / "installed" / "machine_code.py"))
    monkeypatch.setattr(machine_code, "SOURCES", ())
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "own"))
    machine_code.library.cache_clear()
    own = machine_code.library()
    assert own.parent == tmp_path / "own"
    installed = tmp_path / "installed" / "__pycache__" / own.name
    installed.parent.mkdir(parents=True)
    installed.touch()
    machine_code.library.cache_clear()
    assert machine_code.library() == installed
    machine_code.library.cache_clear()


def test_no_simulation_begins_while_another_process_compiles(tmp_path, monkeypatch):
    monkeypatch.setattr(machine_code, "library", lambda: tmp_path / "twist.so")
    assert machine_code.is_ready()
    machine_code.compiled_elsewhere(True)
    assert not machine_code.is_ready()
    (tmp_path / "twist.so").touch()
    assert machine_code.is_ready()
    machine_code.compiled_elsewhere(False)


def test_another_source_is_another_file(monkeypatch):
    machine_code.library.cache_clear()
    before = machine_code.library()
    machine_code.library.cache_clear()
    monkeypatch.setattr(machine_code, "SOURCES", ("laws.py",))
    assert machine_code.library() != before
    machine_code.library.cache_clear()

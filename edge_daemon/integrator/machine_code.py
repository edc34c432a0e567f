"""The compiled integrator without its compiler: numba and LLVM take 100 MB of memory and ten seconds of computing, what
they make of the integrator takes 50 kB and loads at once.

`python -m edge_daemon.integrator.machine_code` makes the file, with the system's linker, in a process of its own. Where
there is no such file, or no linker to make one, numba is loaded into the process that simulates: the same functions.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

SOURCES = ("compiled.py", "laws.py", "twist.py")
"""The files that say what the machine code does."""
LINKERS = ("ld", "ld.lld", "cc")
"""Programs that make a shared library of machine code; any of them will do."""
FOREIGN = ("NRT_", "numba_")
"""Names that begin so belong to numba's own runtime. The functions that would be called have nothing to raise and
nothing to count, and never do."""
COMPILER = "edge_daemon.integrator.compiled"
"""The module whose import loads numba."""

_elsewhere = False


def compiled_elsewhere(so: bool) -> None:
    """Whether another process is making the file: until it is there, no simulation may begin in this one."""
    global _elsewhere
    _elsewhere = so


def is_ready() -> bool:
    """Whether a simulation may begin."""
    return not _elsewhere or library().exists()


@cache
def library() -> Path:
    """Where the machine code is, or will be: another version of its sources is another file. One that was installed
    with the package is taken before one is made in the folder that the service may write."""
    here = Path(__file__).parent
    stamp = hashlib.sha256(b"".join((here / name).read_bytes() for name in SOURCES))
    stamp.update(f"{version('numba')} {platform.system()}".encode())
    name = f"twist-{stamp.hexdigest()[:16]}-{platform.machine()}.so"
    folder, installed = os.environ.get("NUMBA_CACHE_DIR"), here / "__pycache__" / name
    return Path(folder) / name if folder and not installed.exists() else installed


@cache
def entry(name: str) -> Callable[[int, int], None]:
    """A function of the integrator, which takes the addresses of its sizes and of its tables' addresses."""
    if COMPILER not in sys.modules and library().exists():
        function = ctypes.CDLL(str(library()))[name]
    else:
        from edge_daemon.integrator import compiled

        function = getattr(compiled, name).ctypes
    function.argtypes, function.restype = (ctypes.c_void_p, ctypes.c_void_p), None
    made: Callable[[int, int], None] = function
    return made


def load() -> None:
    """Have the functions at hand: at once where the file is, else with numba, in half a second from its cache."""
    entry("advance")


def make() -> Path | None:
    """Compile and link the file; None where the system has no linker, and what is compiled is then kept for numba."""
    from edge_daemon.integrator import compiled

    linker, kept = next(filter(None, map(shutil.which, LINKERS)), None), library()
    if linker is None:
        return None
    kept.parent.mkdir(parents=True, exist_ok=True)
    own, code = kept.with_suffix(f".{os.getpid()}"), kept.with_suffix(f".{os.getpid()}.o")
    functions = [compiled.for_c(cache=False)(made.__wrapped__) for made in (compiled.advance, compiled.follow)]
    code.write_bytes(_object_code(functions))
    subprocess.run([linker, "-shared", "-o", own, code], check=True)  # noqa: S603  (found by name)
    code.unlink()
    return own.replace(kept)


def _object_code(functions: Iterable[Any]) -> bytes:
    """Position-independent code of functions for C, under their plain names."""
    from llvmlite import binding

    module = binding.parse_assembly("")
    for function in functions:
        module.link_in(binding.parse_assembly(function.inspect_llvm()))
        module.get_function(function.native_name).name = function.__name__
    for foreign in list(module.functions):
        if foreign.is_declaration and foreign.name.startswith(FOREIGN):
            kind = str(foreign).splitlines()[-1].split(None, 1)[1].split("#")[0]
            module.link_in(binding.parse_assembly(f"define {kind} {{ unreachable }}"))
    machine = binding.Target.from_default_triple().create_target_machine(opt=3, reloc="pic", codemodel="default")
    code: bytes = machine.emit_object(module)
    return code


if __name__ == "__main__":
    print(make() or "there is no linker: numba is loaded where a gear is simulated")

"""For all tests: one thread for matrices of a few columns; two only cost."""

import os

for library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

"""Tests of the whole project."""

import os

# two workers on two cores, and the processes that they start: further threads would only wait for one another
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

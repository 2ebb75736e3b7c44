"""A sweep worker keeps freed memory for its next run, also where Dask has told glibc to give it back at once."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

SCRIPT = """
import resource, sys
import numpy as np
from cosim.sweep.memory import keep_memory

if sys.argv[1] == "keep":
    keep_memory()
for i in range(21):
    np.ones(1_000_000)  # 8 MB
    if not i:
        first = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - first) / 20)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's allocator is told anything")
def test_freed_memory_serves_the_next_run() -> None:
    def page_faults_a_run(what: str) -> float:
        command = [sys.executable, "-c", SCRIPT, what]
        environment = os.environ | {"MALLOC_TRIM_THRESHOLD_": "65536"}  # what Dask's nanny sets
        return float(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)

    assert page_faults_a_run("keep") < 10
    assert page_faults_a_run("give back") > 100  # at least: pages may be large

"""FMUs of others that raise: an unmodified pythonfmu slave whose `do_step` raises must not take the program down."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fmu_export import build_script

SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Raising(Fmi2Slave):
    def __init__(self, **arguments):
        super().__init__(**arguments)
        self.y = 0.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, time, step):
        if time > 0.45:
            raise RuntimeError("the motor is on fire")
        self.y += step
        return True
"""

RUN = """
import sys
from cosim import SimulationError, System, simulate

for attempt in range(3):
    system = System()
    system.add("motor", sys.argv[1])
    system.add("other", sys.argv[1])
    try:
        simulate(system, 1.0, 0.1)
    except SimulationError as error:
        print(error.component, error.time, len(error.results.time), error.log)
"""


@pytest.fixture
def raising_fmu(tmp_path: Path) -> Path:
    """Any Python behind pythonfmu's binary, without the defect for which it now and then aborts its host at exit."""
    (tmp_path / "raising.py").write_text(SLAVE)
    return build_script(tmp_path / "raising.py", tmp_path)


def test_run_ends_with_name_time_and_log_and_the_process_lives(raising_fmu: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN, raising_fmu], capture_output=True, text=True, cwd=raising_fmu.parent, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    for line in lines:
        assert line.startswith("motor 0.5 6 ")
        assert "the motor is on fire" in line

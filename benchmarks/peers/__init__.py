"""Other co-simulation masters, for the benchmark: the same FMU files, the same step, the same values recorded.

A peer is a module of this package with

- `NAME`, `TITLE` (one line for people), `PACKAGE` (pip or Maven name, by which its version is found),
- `unavailable() -> str | None`: why it can't run here and how to get it, in one line; None where it can,
- `run(case, folder) -> PeerRun`: one run, with `folder` (empty) for files.

Each is driven as its documentation says, in its fastest documented configuration for a fixed step that records all.
A peer may crash or leave threads behind, so run it in a process of its own: `python -m benchmarks.peers NAME CASE OUT`.
"""

from __future__ import annotations

#: Names of the modules, in the order of the table.
PEERS: tuple[str, ...] = (
    "fmpy_loop",
    "fmpy_container",
    "fmu_toolbox",
    "fmu_toolbox_sequential",
    "ecos",
    "libcosim",
    "fmi4j",
    "cofmupy",
    "pathsim",
    "fmipp",
    "omsimulator",
    "pyfmi",
)

"""Other tools that run our FMUs: the same files, the same step, the same values recorded.

A tool is a module of this package with

- `NAME`, `TITLE` (one line for people), `PACKAGE` (pip, Maven or cargo name, by which its version is found),
- `unavailable() -> str | None`: why it can't run here and how to get it, in one line; None where it can,
- `run(case, folder) -> ToolRun`: one run, with `folder` (empty) for files.

Each is driven as its documentation says, in its fastest documented configuration for a fixed step that records all.
A tool may crash or leave threads behind, so run it in a process of its own: `python -m interop.tools NAME CASE OUT`,
or `launch.run_tool`.
"""

from __future__ import annotations

#: Names of the modules.
TOOLS: tuple[str, ...] = (
    "fmpy_loop",
    "fmpy_cli",
    "fmpy_me",
    "fmpy_container",
    "fmpy_ssp",
    "fmu_toolbox",
    "fmu_toolbox_sequential",
    "fmu_toolbox_ssp",
    "ecos",
    "ecos_ssp",
    "libcosim",
    "libcosim_ssp",
    "fmi4j",
    "maestro",
    "cofmupy",
    "pathsim",
    "fmi_sim",
    "c_host",
    "fmipp",
    "omsimulator",
    "pyfmi",
)

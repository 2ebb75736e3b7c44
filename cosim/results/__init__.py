"""Results of runs: in memory, on the disk, as files, tables and plots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cosim.results.results import Results as Results
else:

    def __getattr__(name: str) -> Any:
        if name != "Results":
            raise AttributeError(f"module 'cosim.results' has no attribute {name!r}")
        from cosim.results.results import Results  # NumPy takes a while to import

        return Results

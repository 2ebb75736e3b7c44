"""The error of all that has to do with OSP configurations."""

from __future__ import annotations

from cosim.errors import CosimError


class OSPError(CosimError):
    """An OSP configuration can't be read or run."""

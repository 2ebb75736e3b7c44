"""The error of all that has to do with SSPs."""

from __future__ import annotations

from cosim.errors import CosimError


class SSPError(CosimError):
    """An SSP can't be read, run or written."""

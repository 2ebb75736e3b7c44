"""Errors of a sweep as a whole; a run that fails is a row."""

from __future__ import annotations

from cosim.errors import CosimError


class SweepError(CosimError):
    """A sweep can't be made as described, or can't go on; what has been computed is kept."""


class WorkerTrouble(CosimError):
    """A worker can't run anything, whatever the point: its disk is full, or it has another version."""

"""Version and author that FMUs carry."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

DISTRIBUTION = "closed-chain-cosim"


def package_version() -> str:
    """Version of the installed distribution; "0+unknown" in a checkout that was never installed."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "0+unknown"

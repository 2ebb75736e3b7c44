"""Versions of what a run was made with."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

#: Name of this project as a distribution.
_DISTRIBUTION = "closed-chain-cosim"

_PACKAGES = (_DISTRIBUTION, "fmpy", "numpy", "scipy")


def package_version() -> str:
    """Version of this package; "not installed" in a checkout that was never installed."""
    return _version(_DISTRIBUTION)


def versions() -> dict[str, str]:
    """Versions of Python, the platform and the packages that a result depends on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    return found | {name: _version(name) for name in _PACKAGES}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"

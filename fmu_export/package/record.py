"""What FMU files were built from, in `.built.json` beside them: what has not changed is not built again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from fmu_export.errors import needs
from fmu_export.package.archive import replacing

RECORD = ".built.json"

#: Packages whose version decides what comes out of a build.
_PACKAGES = ("casadi", "fmpy", "latex2mathml", "markdown", "numpy", "pillow", "pythonfmu")


@dataclass(frozen=True)
class Recipe:
    """Fingerprints of all that decides on the bytes of an FMU file."""

    sources: str
    tools: str


def fingerprint_of_sources(sources: Iterable[Path]) -> str:
    """Fingerprint of files, and of all sources below folders.

    Raises
    ------
    OSError
        A source can't be read.
    """
    digest = hashlib.sha256()
    for source in sources:
        files = sorted(p for p in source.rglob("*.[pchjms]*") if p.suffix in (".py", ".c", ".h", ".js", ".md", ".svg"))
        for path in files if source.is_dir() else [source]:
            name = path.relative_to(source).as_posix() if source.is_dir() else path.name
            digest.update(f"{name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def fingerprint_of_tools(*others: str) -> str:
    """Fingerprint of the packages that take part in a build, and of what else does: compiler, platforms, version.

    Raises
    ------
    MissingExtra
        One of the packages is not installed.
    """
    with needs("export"):
        packages = [f"{name} {version(name)}" for name in _PACKAGES]
    return hashlib.sha256("\0".join([*others, *packages]).encode()).hexdigest()


def is_current(path: Path, wanted: Recipe) -> bool:
    """Whether a file was built by this recipe and has not been changed since."""
    entry = _entries(path).get(path.name)
    return entry is not None and path.is_file() and entry == _entry(path, wanted)


def has_other_sources(path: Path, sources: str) -> bool:
    """Whether a file is known to be built from other sources; it may have been changed since, as by the gain tool."""
    entry = _entries(path).get(path.name)
    return entry is not None and entry.get("sources") != sources


def remember(path: Path, used: Recipe) -> None:
    """Note by which recipe a file has just been built.

    Raises
    ------
    OSError
        The note can't be written.
    """
    entries = _entries(path) | {path.name: _entry(path, used)}
    with replacing(path.with_name(RECORD)) as stream:
        stream.write(json.dumps(entries, indent=2, sort_keys=True).encode() + b"\n")


def _entry(path: Path, used: Recipe) -> dict[str, str]:
    return {**asdict(used), "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def _entries(path: Path) -> dict[str, dict[str, str]]:
    """The notes beside a file; none where they are missing or damaged, for then all is built again."""
    try:
        entries = json.loads(path.with_name(RECORD).read_bytes())
    except (OSError, ValueError):
        return {}
    right = isinstance(entries, dict) and all(isinstance(e, dict) for e in entries.values())
    return entries if right else {}

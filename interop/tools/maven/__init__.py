"""Java packages by Maven, which fetches them once; what each needs is in a POM of this folder."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

_FOLDER = Path(__file__).parent
_CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "closed-chain-cosim"


def unavailable(name: str) -> str | None:
    """Why the packages of `<name>.xml` can't be used here, in one line; None where they can."""
    if shutil.which("javac") is None or shutil.which("mvn") is None:
        return "needs a JDK (17 or newer) and Maven: apt-get install default-jdk-headless maven"
    try:
        class_path(name)
    except subprocess.CalledProcessError:
        return f"Maven can't get the packages of {_FOLDER.name}/{name}.xml"
    return None


@cache
def class_path(name: str) -> list[str]:
    """Files of the packages of `<name>.xml`; Maven takes seconds to say them, so that a file keeps them."""
    pom = _FOLDER / f"{name}.xml"
    kept = _CACHE / f"{name}-classpath"
    if not _is_current(kept, pom):
        _CACHE.mkdir(parents=True, exist_ok=True)
        command = ("mvn", "--quiet", "--batch-mode", "--file", str(pom))
        subprocess.run(
            [*command, "dependency:build-classpath", f"-Dmdep.outputFile={kept}"], check=True, capture_output=True
        )
    return kept.read_text(encoding="utf-8").split(os.pathsep)


def _is_current(kept: Path, pom: Path) -> bool:
    return (
        kept.is_file()
        and kept.stat().st_mtime >= pom.stat().st_mtime
        and all(Path(jar).is_file() for jar in kept.read_text(encoding="utf-8").split(os.pathsep))
    )

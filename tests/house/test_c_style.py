"""The C has the format of `.clang-format`."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import clang_format

from tests.support import CHECKOUT

TOOL = Path(clang_format.__file__).parent / "data/bin/clang-format"


def unformatted(*files: Path) -> list[str]:
    """What clang-format would change, one line a place."""
    command = [TOOL, f"--style=file:{CHECKOUT / '.clang-format'}", "--dry-run", *files]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [line for line in done.stderr.splitlines() if "[-Wclang-format-violations]" in line]


def formatted() -> list[Path]:
    files = [p for folder in ("cosim", "fmu_export", "interop") for p in sorted((CHECKOUT / folder).rglob("*.[ch]"))]
    ours = {"libm.h", "acosh_domain.c"}  # the other elementary functions are musl's, as they are
    return [p for p in files if p.parent.name != "libm" or p.name in ours]


def test_c_is_formatted() -> None:
    assert len(formatted()) > 5
    assert unformatted(*formatted()) == []


def test_the_hook_formats_the_same_files() -> None:
    hook = (CHECKOUT / ".pre-commit-config.yaml").read_text(encoding="utf-8").partition("id: clang-format")[2]
    exclude = re.search(r"^ +exclude: (.+)$", hook, re.MULTILINE)
    assert exclude is not None
    rooms = [CHECKOUT / folder for folder in ("cosim", "fmu_export", "interop", "tests")]
    names = {p.relative_to(CHECKOUT).as_posix() for room in rooms for p in room.rglob("*.[ch]")}
    chosen = {name for name in names if not re.search(exclude[1], name)}
    assert chosen == {p.relative_to(CHECKOUT).as_posix() for p in formatted()} != names


def test_what_is_not_formatted_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "a.c").write_text("int f(int a)\n{\n  return a;\n}\n")
    assert len(unformatted(tmp_path / "a.c")) >= 2

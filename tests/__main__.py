"""Everything that must pass: `python -m tests` (style, types, tests; with `--coverage` also that)."""

from __future__ import annotations

import subprocess
import sys

CHECKS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
    # by file: the tests of a file share FMUs and runs
    ("pytest", "-n", "2", "--dist", "loadfile"),
)
COVERAGE = ("--cov", "--cov-report=term")


def main() -> int:
    """Run all checks, and fail if any failed."""
    failed = []
    for command in CHECKS:
        if "--coverage" in sys.argv[1:] and command[0] == "pytest":  # takes a third longer
            command = (*command, *COVERAGE)
        print("$", *command, flush=True)
        if subprocess.run([sys.executable, "-m", *command], check=False).returncode:
            failed.append(command[0])
    if failed:
        print("failed:", *failed)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())

"""Everything that must pass: `python -m tests` (style, types, tests, coverage)."""

from __future__ import annotations

import subprocess
import sys

CHECKS = (
    ("ruff", "check", "."),
    ("ruff", "format", "--check", "."),
    ("mypy",),
    # by file: the tests of a file share FMUs and runs
    ("pytest", "-n", "2", "--dist", "loadfile", "--cov", "--cov-report=term"),
)


def main() -> int:
    """Run all checks, and fail if any failed."""
    failed = []
    for command in CHECKS:
        print("$", *command, flush=True)
        if subprocess.run([sys.executable, "-m", *command], check=False).returncode:
            failed.append(command[0])
    if failed:
        print("failed:", *failed)
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())

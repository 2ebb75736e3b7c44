"""Lock all requirements with hashes, and list them as a bill of materials: `python requirements/update.py`.

    run.txt, all.txt, test.txt   what `pip install --require-hashes -r FILE` installs: nothing but the package's own
                                 dependencies, all extras, all that tests need; for every platform and Python version
    sbom.json                    all.txt in CycloneDX's JSON, without time and serial number

Needs the extra `release`. No file names the index that was asked, nor where files lie there.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).parent
PYPROJECT = HERE.parent / "pyproject.toml"

#: File -> extra.
LOCKS = {"run.txt": "", "all.txt": "all", "test.txt": "test"}

_LOCK = "--universal --generate-hashes --no-emit-index-url --no-annotate --no-header --quiet --python-version 3.11"


def lock(name: str, extra: str) -> None:
    """Write a file of requirements; what is in it already stays, unless it can't."""
    extras = ["--extra", extra] if extra else []
    command = [sys.executable, "-m", "uv", "pip", "compile", str(PYPROJECT), *extras, *_LOCK.split()]
    subprocess.run([*command, "--output-file", str(HERE / name)], check=True)


def bill_of_materials() -> None:
    """Write sbom.json: names, versions and package URLs."""
    pinned = [line.split(" \\")[0] for line in (HERE / "all.txt").read_text(encoding="utf-8").splitlines()]
    with TemporaryDirectory() as folder:
        plain, bill = Path(folder) / "all.txt", Path(folder) / "sbom.json"
        plain.write_text("\n".join(line for line in pinned if not line.startswith(" ")) + "\n", encoding="utf-8")
        command = [sys.executable, "-W", "ignore", "-m", "cyclonedx_py", "requirements", str(plain)]
        options = ["--pyproject", str(PYPROJECT), "--output-reproducible", "--spec-version", "1.6"]
        subprocess.run([*command, *options, "--output-format", "JSON", "--output-file", str(bill)], check=True)
        content = json.loads(bill.read_text(encoding="utf-8"))
    _drop(content, "externalReferences")  # among them where the index has its files
    for component in content["components"]:
        marker = re.search(r";.*", component.pop("description", ""))
        if marker is not None:
            component["description"] = f"where {marker[0].removeprefix(';').strip()}"
    (HERE / "sbom.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _drop(content: object, key: str) -> None:
    """Remove a key from objects and lists, however deep."""
    if isinstance(content, dict):
        content.pop(key, None)
    for value in content.values() if isinstance(content, dict) else content if isinstance(content, list) else ():
        _drop(value, key)


def main() -> None:
    """Write all files."""
    for name, extra in LOCKS.items():
        lock(name, extra)
    bill_of_materials()


if __name__ == "__main__":
    main()

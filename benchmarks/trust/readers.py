"""Archives of FMUs and SSPs by a fuzzer that follows the coverage of the readers: only our errors may come of them.

Needs Atheris (`pip install atheris`, Linux). Each kind begins with a whole archive; changed are its bytes, or those
of its description only, in a whole archive.
"""

from __future__ import annotations

import argparse
import io
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

#: What is changed of which archive.
KINDS = ("fmu", "fmu description", "ssp", "ssp description")


def seed_of(kind: str, folder: Path) -> tuple[bytes, str]:
    """A whole archive, without libraries, and the name of its description."""
    from cosim import System
    from cosim.ssp import Experiment, write_ssp
    from fmu_export import build_native
    from tests.support.typed_model import TYPED

    fmu = build_native(TYPED, folder, "fmi2", reference=False)
    buffer = io.BytesIO()
    if kind.startswith("ssp"):
        system = System()
        system.add("m", fmu)
        write_ssp(folder / "s.ssp", system, "s", Experiment(1.0, 0.1))
        return (folder / "s.ssp").read_bytes(), "SystemStructure.ssd"
    with zipfile.ZipFile(fmu) as whole, zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as small:
        for name in whole.namelist():
            if not name.startswith(("sources/", "documentation/", "extra/")):
                small.writestr(name, whole.read(name))
    return buffer.getvalue(), "modelDescription.xml"


def with_description(archive: bytes, name: str, text: bytes) -> bytes:
    """The archive with another description."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(archive)) as old, zipfile.ZipFile(buffer, "w") as new:
        for member in old.namelist():
            new.writestr(member, text if member == name else old.read(member))
    return buffer.getvalue()


def reader(kind: str, folder: Path) -> Callable[[bytes], None]:
    """What reads the bytes, and lets nothing through but an error of this project, in one line."""
    from cosim.errors import CosimError
    from cosim.fmi.fmu_file import check_fmu
    from cosim.ssp import read_ssp

    whole, name = seed_of(kind, folder)
    path = folder / f"fuzzed.{kind[:3]}"

    def read(data: bytes) -> None:
        path.write_bytes(with_description(whole, name, data) if kind.endswith("description") else data)
        try:
            if kind.startswith("fmu"):
                check_fmu(path, "fuzzed")
            else:
                with tempfile.TemporaryDirectory(dir=folder) as unpacked:
                    read_ssp(path, unpacked)
        except CosimError as error:
            if not str(error) or "\n" in str(error):
                raise AssertionError(f"an error that is not a line: {str(error)!r}") from error

    return read


def fuzz(kind: str, seconds: int, folder: Path) -> None:
    """Fuzz in this process, which libFuzzer ends."""
    import atheris  # type: ignore[import-not-found]

    with atheris.instrument_imports(include=["cosim.fmi", "cosim.ssp"]):
        read = reader(kind, folder)
    whole, name = seed_of(kind, folder)
    corpus = folder / "corpus"
    corpus.mkdir()
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        (corpus / "whole").write_bytes(archive.read(name) if kind.endswith("description") else whole)
    options = [f"-max_total_time={seconds}", "-timeout=30", "-rss_limit_mb=4096", f"-artifact_prefix={folder}/"]
    atheris.Setup([sys.argv[0], *options, "-print_final_stats=1", "-max_len=65536", str(corpus)], read)
    atheris.Fuzz()


def main() -> int:
    """Fuzz each kind in a process of its own; returns 0 when nothing is found."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trust.readers", description=__doc__)
    parser.add_argument("--seconds", type=int, default=600, help="of each kind (default %(default)s)")
    parser.add_argument("--kind", choices=KINDS, help="the one to fuzz in this process")
    options = parser.parse_args()
    if options.kind:
        with tempfile.TemporaryDirectory(prefix="readers_") as folder:
            fuzz(options.kind, options.seconds, Path(folder))
        return 0
    wrong = 0
    for kind in KINDS:
        command = [sys.executable, "-m", "benchmarks.trust.readers", "--kind", kind, "--seconds", str(options.seconds)]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        read = re.search(r"number_of_executed_units: (\d+)", done.stderr)
        wrong += done.returncode != 0
        print(f"{kind}: {read[1] if read else 'no'} archives read, {'found:' if done.returncode else 'nothing found'}")
        if done.returncode:
            print(done.stderr[-3000:])
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())

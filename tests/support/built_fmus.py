"""FMUs of models for tests, built when they are first asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmu_export.modelling.model import Model
from fmu_export.native.backend import build_native
from tests.support.compilation import shared_compilation
from tests.support.native_fmus import Host, require_compiler, unpack


class Built:
    """FMUs of models, each built and unpacked once; `host` gives an instance."""

    def __init__(self, folder: Path) -> None:
        require_compiler()
        self._folder = folder
        self._unpacked: dict[tuple[str, str, str], Path] = {}

    def fmu(self, of: Model, flavour: str = "fmi2") -> Path:
        key = (of.name, of.solver, flavour)
        if key not in self._unpacked:
            place = self._folder / "-".join(key)
            with shared_compilation():
                built = build_native(of, place, flavour)  # type: ignore[arg-type]
            self._unpacked[key] = unpack(built, place / "unpacked")
        return self._folder / "-".join(key) / f"{of.name}.fmu"

    def host(self, of: Model, flavour: str = "fmi2", **options: Any) -> Host:
        self.fmu(of, flavour)
        return Host(self._unpacked[of.name, of.solver, flavour], **options)

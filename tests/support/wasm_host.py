"""A host of WebAssembly modules in Python, by wasmtime: what `model.js` does in a browser."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from fmu_export.wasm.backend import WasmModel


class WasmHost:
    """An instance of a module; calls return a status, and `message` is what the last message said."""

    def __init__(self, made: WasmModel) -> None:
        wasmtime = pytest.importorskip("wasmtime", reason="nothing here runs WebAssembly: pip install wasmtime")
        self.description = made.description
        self._store = wasmtime.Store()
        module = wasmtime.Module(self._store.engine, made.module)
        self.imports = list(module.imports)
        self._exports = wasmtime.Instance(self._store, module, []).exports(self._store)
        self.references = {v["name"]: i for i, v in enumerate(made.description["variables"])}
        self.inputs = [v["name"] for v in made.description["variables"] if v["causality"] == "input"]
        for number, table in enumerate(made.description["tables"]):
            self.write(self.call("tableData", number, *table["size"]), table["data"])
        self.start({})

    def call(self, function: str, *arguments: float) -> Any:
        return self._exports[function](self._store, *arguments)

    def write(self, address: int, values: Sequence[float] | np.ndarray, dtype: str = "<f8") -> int:
        self._exports["memory"].write(self._store, np.asarray(values, dtype).tobytes(), address)
        return address

    def read(self, address: int, n: int) -> np.ndarray:
        return np.frombuffer(self._exports["memory"].read(self._store, address, address + 8 * n), "<f8")

    def given(self, values: Sequence[float] | np.ndarray, dtype: str = "<f8") -> int:
        """Address of values in memory of their own."""
        content = np.asarray(values, dtype)
        return self.write(self.call("allocate", max(content.nbytes, 8)), content, dtype)

    @property
    def message(self) -> str:
        address = self.call("message")
        return self._exports["memory"].read(self._store, address, address + 1024).split(b"\0")[0].decode()

    def start(self, start: Mapping[str, float]) -> int:
        """Make the instance with other start values than those of the description."""
        known = [v for v in self.description["variables"] if "start" in v]
        self.write(self.call("startValues"), [start.get(v["name"], v["start"]) for v in known])
        return self.call("instantiate")

    def set(self, values: Mapping[str, float]) -> int:
        references = self.given([self.references[name] for name in values], "<u4")
        return self.call("set", references, len(values), self.given(list(values.values())))

    def get(self, *names: str) -> np.ndarray:
        place = self.given(np.zeros(len(names)))
        assert self.call("get", self.given([self.references[n] for n in names], "<u4"), len(names), place) <= 1
        return self.read(place, len(names))

    def run(
        self,
        size: float,
        n: int,
        recorded: Sequence[str],
        inputs: np.ndarray | None = None,
        linear: bool = False,
        first: int = 0,
    ) -> np.ndarray:
        """Rows of the points that are complete, (points, recorded)."""
        stride = first + n + 1
        columns = self.given(np.zeros(len(recorded) * stride))
        references = self.given([self.references[name] for name in recorded], "<u4")
        rows = 0 if inputs is None else self.given(inputs)
        row = self.given(np.zeros(len(recorded)))
        arguments = rows, int(linear), references, len(recorded), row, columns, stride
        points = self.call("run", 0.0, size, first, n, *arguments)
        return self.read(columns, len(recorded) * stride).reshape(len(recorded), stride).T[first : first + points]


def json_of(module: bytes) -> dict[str, Any]:
    """The description that stands in a module, read by its bytes."""
    assert module[:8] == b"\0asm\1\0\0\0"
    at, found = 8, None
    while at < len(module):
        kind = module[at]
        size, at = _length(module, at + 1)
        content, at = module[at : at + size], at + size
        if kind == 0:
            n, begin = _length(content, 0)
            if content[begin : begin + n] == b"model":
                found = json.loads(content[begin + n :])
    assert found is not None
    return found


def _length(content: bytes, at: int) -> tuple[int, int]:
    number = shift = 0
    while True:
        number |= (content[at] & 0x7F) << shift
        shift, at = shift + 7, at + 1
        if content[at - 1] < 0x80:
            return number, at

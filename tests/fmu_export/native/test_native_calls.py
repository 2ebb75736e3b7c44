"""Calls in any order, with any arguments, of the C of native FMUs under sanitisers."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from controller_fmu.model import MODEL as CONTROLLER
from tests.support.hybrid_models import SAMPLED_PI
from tests.support.native_calls import SANITISERS, compile_calls, make_calls
from tests.support.native_fmus import FLAVOURS
from tests.support.typed_model import TYPED

MODELS = {model.name: model for model in (TYPED, SAMPLED_PI, CONTROLLER)} | {
    "rodas4": replace(CONTROLLER, solver="rodas4")
}


@pytest.fixture(scope="module")
def compiler(tmp_path_factory: pytest.TempPathFactory) -> str:
    probe = tmp_path_factory.mktemp("probe") / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    for name in ("cc", "gcc", "clang"):
        command = [name, *SANITISERS, str(probe), "-o", str(probe.with_suffix(""))]
        if shutil.which(name) and subprocess.run(command, capture_output=True, check=False).returncode == 0:
            return name
    pytest.skip("no C compiler with address and undefined-behaviour sanitisers (cc, gcc, clang) is on the path")


def trials() -> list[Any]:
    """Model and flavour; one is not slow."""
    return [
        pytest.param(name, flavour, marks=() if (name, flavour) == (TYPED.name, "fmi3") else pytest.mark.slow)
        for name in MODELS
        for flavour in FLAVOURS
    ]


@pytest.mark.parametrize(("name", "flavour"), trials())
def test_nothing_comes_of_calls_that_the_standard_does_not_say(
    name: str, flavour: Any, compiler: str, tmp_path: Path
) -> None:
    """Forbidden calls are errors with a message, what is returned as good is finite, and sanitisers find nothing."""
    program, resources = compile_calls(MODELS[name], flavour, tmp_path, compiler, arrays=flavour == "fmi3")
    made, wrong = make_calls(program, resources, 100_000, seed=1)
    assert wrong == ""
    assert made >= 100_000

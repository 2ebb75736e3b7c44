"""What a regression must find, at the tolerance of 1e-9 of a range, and what it must let pass."""

from __future__ import annotations

import platform
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.regression import Tolerance, Tolerances, check, compare
from cosim.regression.case import Case
from cosim.regression.run import run
from cosim.results.results import Results
from fmu_export.native.toolchain import find_compiler
from fmu_export.package.start_values import write_start_values
from tests.support.regression_fmus import built_fmus, make_case
from tests.support.small_fmus import redescribed

#: Model exchange has another integrator; what that differs by is no matter of these tests.
TOML = "relative = 1e-9\n[model_exchange]\nrelative = 1e-7\n"


@pytest.fixture
def fmus() -> Path:
    return built_fmus()


def case_of(fmus: Path, folder: Path, name: str, toml: str = TOML) -> Case:
    """A case whose reference is what the FMU itself gives."""
    stop, step = {"VanDerPol": (10.0, 0.01), "Stair": (1.0, 0.01)}.get(name, (2.0, 0.01))
    inputs = Results(np.arange(3.0), ["u"], np.array([[0.0], [1.0], [-1.0]])) if name == "Feedthrough" else None
    opt = f"StartTime, 0\nStopTime, {stop}\nStepSize, {step}\nRelTol, 1e-11\n"
    case = make_case(folder, name, toml=toml, opt=opt, inputs=inputs)
    run(case, fmus / f"{name}.fmu", "co_simulation").to_csv(case.reference_path)
    return case


def findings(case: Case, fmu: Path, interface: str = "co_simulation") -> list[str]:
    found = check(case, fmu, interface, isolated=False).findings
    assert not any("\n" in line for line in found)
    return found


@pytest.mark.parametrize("name", ["Dahlquist", "VanDerPol", "Feedthrough", "Stair"])
@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_a_parameter_changed_by_a_millionth_is_found(fmus, tmp_path, name, interface):
    case = case_of(fmus, tmp_path, name)
    assert findings(case, fmus / f"{name}.fmu", interface) == []
    parameter, start = {
        "Dahlquist": ("k", 1.0), "VanDerPol": ("mu", 1.0), "Feedthrough": ("K", 1.0), "Stair": ("T", 0.25)
    }[name]  # fmt: skip
    changed = tmp_path / f"{name}.fmu"
    changed.write_bytes((fmus / f"{name}.fmu").read_bytes())
    write_start_values(changed, {parameter: start * (1.0 + 1e-6)})
    found = findings(case, changed, interface)
    assert found
    assert "differs at" in found[0]


def test_a_shifted_event_is_found_and_let_pass_within_its_time_shift(fmus, tmp_path):
    """The stair rises 10, 20 and 30 ms late."""
    case_of(fmus, tmp_path, "Stair")
    for toml, found in (
        ("relative = 1e-9\n", "differs at 6 of 101 times"),
        ("relative = 1e-9\ntime_shift = 0.025\n", "leaves the funnel at 1 of 101 times, most at t = 0.77 s: 2"),
        ("relative = 1e-9\ntime_shift = 0.035\n", ""),
    ):
        lines = findings(make_case(tmp_path, "Stair", toml="start.T = 0.26\n" + toml), fmus / "Stair.fmu")
        assert bool(lines) == bool(found), lines
        assert all(found in line for line in lines)


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_a_bounce_shifted_by_microseconds_is_found(fmus, tmp_path, interface):
    tolerances = "absolute = 1e-6\ntime_shift = 1e-6\n"
    assert findings(case_of(fmus, tmp_path, "Ball", tolerances), fmus / "Ball.fmu", interface) == []
    shifted = make_case(tmp_path, "Ball", toml="start.e = 0.70001\n" + tolerances)
    assert len(findings(shifted, fmus / "Ball.fmu", interface)) == 2


def test_a_missing_variable_is_found(fmus, tmp_path):
    case = case_of(fmus, tmp_path, "VanDerPol")
    other = redescribed(fmus / "VanDerPol.fmu", tmp_path / "VanDerPol.fmu", {'name="x1"': 'name="x2"'})
    assert findings(case, other) == ["'x1' is missing in the result; did you mean 'x0'?"]


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
@pytest.mark.parametrize("tolerance", ["absolute = 1e9", "absolute = 1e9\ntime_shift = 0.1"])
def test_a_value_that_is_no_number_is_found(fmus, tmp_path, interface, tolerance):
    case = case_of(fmus, tmp_path, "Ball", tolerance)
    assert findings(case, fmus / "Ball.fmu", interface) == []
    case = make_case(tmp_path, "Ball", toml=f"start.nan_at = 1.0\n{tolerance}")
    (found,) = findings(case, fmus / "Ball.fmu", interface)
    assert "'h'" in found
    assert "nan" in found
    assert "t = 1 s" in found


@pytest.mark.parametrize("tolerance", ["relative = 1e-9", "relative = 1e-9\ntime_shift = 0.1"])
@pytest.mark.parametrize("rows", [-1, 1])
def test_a_longer_or_shorter_reference_is_found(fmus, tmp_path, tolerance, rows):
    case = case_of(fmus, tmp_path, "Dahlquist", tolerance)
    reference = case.reference()
    time = np.arange(201 + rows) * 0.01
    values = np.interp(time, reference.time, reference["x"])[:, None]
    Results(time, ["x"], values).to_csv(case.reference_path)
    (found,) = findings(case, fmus / "Dahlquist.fmu")
    assert ("rows" in found) == ("time_shift" not in tolerance)
    assert f"{201 + rows}" in found or "at t = 2" in found


def test_another_unit_is_found(fmus, tmp_path):
    case = case_of(fmus, tmp_path, "Dahlquist", TOML + "[signals]\nx = { unit = 'm' }\n")
    assert findings(case, fmus / "Dahlquist.fmu") == []
    for unit in ("1", "none"):
        other = tmp_path / "Dahlquist.fmu"
        redescribed(fmus / "Dahlquist.fmu", other, {'unit="m" ': f'unit="{unit}" ' if unit != "none" else ""})
        shown = unit if unit != "none" else ""
        line = f"'x' has the unit '{shown}' in the result, 'm' in the tolerances"
        for interface in ("co_simulation", "model_exchange"):
            assert findings(case, other, interface) == [line]
    # and the other way round: a signal that should have none
    none = make_case(tmp_path, "Dahlquist", toml=TOML + "[signals]\nx = { unit = '' }\n")
    assert findings(none, fmus / "Dahlquist.fmu") == ["'x' has the unit 'm' in the result, '' in the tolerances"]


@pytest.mark.skipif(sys.platform == "win32", reason="options of gcc and clang")
@pytest.mark.parametrize(
    "options",
    [
        ["-O0", "-ffp-contract=off"],
        ["-O3", "-ffast-math", "-ffp-contract=fast", *(["-march=native"] if platform.machine() == "x86_64" else [])],
    ],
)
def test_the_same_fmu_with_other_last_digits_passes(fmus, tmp_path, options):
    """As another platform or compiler has them."""
    case = case_of(fmus, tmp_path, "VanDerPol")
    other = recompiled(fmus / "VanDerPol.fmu", tmp_path, options)
    results = run(case, other, "co_simulation")
    difference = np.abs(results.values - case.reference().values).max()
    assert (difference > 0.0) == ("-ffast-math" in options), difference
    for interface in ("co_simulation", "model_exchange"):
        assert findings(case, other, interface) == []


def test_a_few_units_in_the_last_place_pass_but_not_at_no_tolerance(fmus, tmp_path):
    reference = case_of(fmus, tmp_path, "VanDerPol").reference()
    generator = np.random.default_rng(1)
    noise = generator.integers(-4, 5, reference.values.shape) * np.spacing(reference.values)
    noisy = Results(reference.time, reference.names, reference.values + noise)
    assert compare(noisy, reference, Tolerances()) == []
    assert compare(noisy, reference, Tolerances(time_shift=1e-6)) == []
    assert len(compare(noisy, reference, Tolerances(relative=0.0))) == 2


def test_each_finding_can_be_had_for_one_signal_only():
    """Tolerances of one signal don't reach the others."""
    time = np.arange(11) * 0.1
    reference = Results(time, ["a", "b[1]", "b[2]"], np.column_stack([time, time, time]))
    result = Results(time, reference.names, reference.values + 0.5)
    own = Tolerances(signals={"b": Tolerance(absolute=1.0)})
    assert [line[:3] for line in compare(result, reference, own)] == ["'a'"]
    own = Tolerances(signals={"b": Tolerance(absolute=1.0), "b[2]": Tolerance()})
    assert [line.split()[0] for line in compare(result, reference, own)] == ["'a'", "'b[2]'"]


def recompiled(fmu: Path, folder: Path, options: list[str]) -> Path:
    """An FMU with its own sources compiled anew."""
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder / "unpacked")
        names = archive.namelist()
    (binary,) = [name for name in names if name.startswith("binaries/") and not name.endswith("/")]
    sources = [str(folder / "unpacked" / n) for n in names if n.startswith("sources/") and n.endswith(".c")]
    objects = [f"{Path(source).stem}.o" for source in sources]
    flags = ["-std=c99", "-fPIC", *options, f"-I{folder / 'unpacked' / 'sources'}"]
    compiler = find_compiler()
    subprocess.run([*compiler, *flags, "-c", *sources], check=True, cwd=folder)
    # linked with -ffast-math, a library switches off subnormal numbers in the whole process that loads it
    subprocess.run(
        [*compiler, "-shared", *objects, "-o", str(folder / "unpacked" / binary), "-lm"], check=True, cwd=folder
    )
    path = folder / fmu.name
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            if not name.endswith("/"):
                archive.write(folder / "unpacked" / name, name)
    return path

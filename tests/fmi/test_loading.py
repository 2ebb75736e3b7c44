"""FMUs whose libraries need something of their surroundings, or lack something: loaded, or refused in one line."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import fmpy
import pytest
from pythonfmu.builder import FmuBuilder

import cosim.fmi.compilation
import cosim.fmi.unpacking
import cosim.master.loaded_components
from cosim import SetupError, Simulation, SimulationError, System, simulate
from cosim.fmi.load_failure import why_not_loaded
from cosim.fmi.own_variables import unique_symbols
from cosim.fmi.unpacking import folder_for_fmus, is_plain
from fmu_export import build_script
from tests.support.c_fmus import binary, compile_c, description_of_tank, packed, sources_of_tank, tank
from tests.support.fmi3_gain import HELD
from tests.support.small_fmus import redescribed

#: What a URI escapes, other than a space, and what file systems take.
UNSAFE = "ä#%&;(@+"

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="about the loader of Linux")


def system_of(*fmus: Path) -> System:
    """Tanks with x' = 1, 2, ..."""
    system = System()
    for n, fmu in enumerate(fmus, start=1):
        system.add(f"tank{n}", fmu, start={"u": float(n)})
    return system


def levels(*fmus: Path, build: bool = False) -> list[float]:
    """What the tanks have after two seconds, divided by two."""
    results = simulate(system_of(*fmus), 2.0, 0.5, build=build)
    return [float(results[f"tank{n}.y"][-1]) / 2.0 for n in range(1, len(fmus) + 1)]


def refusal(fmu: Path, *, build: bool = False) -> str:
    """The line in which an FMU is refused."""
    with pytest.raises(SetupError) as error:
        levels(fmu, build=build)
    message = str(error.value)
    assert message.startswith(f"component 'tank1': {fmu}")
    assert "\n" not in message
    return message


# Functions that are absent


def test_optional_functions_may_be_absent(tmp_path: Path) -> None:
    """Also fmi2Reset, which no FMU may leave out: the instance is made anew for the next run."""
    with Simulation(system_of(tank(tmp_path / "tank.fmu"))) as simulation:
        for _ in range(3):
            assert simulation.run(2.0, 0.5)["tank1.y"][-1] == 2.0


def test_an_absent_function_that_is_called_is_named(tmp_path: Path) -> None:
    integer = {'causality="input"><Real start="0"/>': 'causality="input"><Integer start="0"/>'}
    system = System()
    system.add("tank", redescribed(tank(tmp_path / "tank.fmu"), tmp_path / "integer.fmu", integer), start={"u": 1})
    with pytest.raises(SetupError, match=r"^an FMU of component 'tank' lacks the function fmi2GetInteger$"):
        simulate(system, 1.0, 0.5, record=["tank.u"])
    with pytest.raises(SimulationError, match=r"^tank failed at t = 0 s: lacks the function fmi2SetInteger$"):
        simulate(system, 1.0, 0.5)
    system.components["tank"].start.clear()
    results = simulate(system, 1.0, 0.5)
    assert (results.names, results.info["not_recorded"]) == (
        ["tank.y"],
        {"tank.u": "it lacks the function fmi2GetInteger"},
    )


def test_functions_may_begin_with_the_model_identifier(tmp_path: Path) -> None:
    """As those of sources that are meant to be linked to others, which FMI2_FUNCTION_PREFIX names."""
    assert levels(tank(tmp_path / "tank.fmu", "FMI2_FUNCTION_PREFIX=tank_")) == [1.0]


# One instance in a process


def test_an_fmu_that_allows_one_instance_in_a_process_is_there_twice(tmp_path: Path) -> None:
    once = tank(tmp_path / "once.fmu", "ONCE", attributes='canBeInstantiatedOnlyOncePerProcess="true"')
    assert levels(once, once, once) == [1.0, 2.0, 3.0]
    system = system_of(once, once)
    with Simulation(system) as first, Simulation(system) as second:
        for _ in range(2):
            for simulation in (first, second):
                assert simulation.run(2.0, 0.5)["tank2.y"][-1] == 4.0


def test_an_fmu_that_does_not_say_so_is_there_twice_too(tmp_path: Path) -> None:
    once = tank(tmp_path / "once.fmu", "ONCE")
    assert levels(once, once, once) == [1.0, 2.0, 3.0]


# Global variables of libraries


def runs(*fmus: Path) -> list[list[float]]:
    """What the tanks have after two seconds, divided by two, in three runs of one simulation."""
    with Simulation(system_of(*fmus)) as simulation:
        results = [simulation.run(2.0, 0.5) for _ in range(3)]
    return [[float(found[f"tank{n}.y"][-1]) / 2.0 for n in range(1, len(fmus) + 1)] for found in results]


@pytest.mark.parametrize("options", [(), pytest.param(("-Wl,-z,nodelete",), marks=linux)], ids=["usual", "nodelete"])
def test_instances_share_no_global_variables(tmp_path: Path, options: tuple[str, ...]) -> None:
    """Neither those of one FMU, nor those of runs, also where the loader never unloads the library."""
    fmu = tank(tmp_path / "global.fmu", "GLOBAL", options=options)
    same = shutil.copy(fmu, tmp_path / "same.fmu")
    assert runs(fmu, same, fmu) == [[1.0, 2.0, 3.0]] * 3
    assert levels(fmu, fmu) == [1.0, 2.0]


@linux
def test_unique_symbols_are_those_of_one_library(tmp_path: Path) -> None:
    """The loader knows one for the whole process, also for FMUs that differ."""
    fmu = tank(tmp_path / "unique.fmu", "UNIQUE")
    assert unique_symbols(fmu.with_suffix(".so").read_bytes())
    other = tank(tmp_path / "other.fmu", "UNIQUE", "OTHER")
    assert runs(fmu, other, fmu) == [[1.0, 2.0, 3.0]] * 3


@linux
def test_unique_symbols_of_what_is_damaged_are_none(tmp_path: Path) -> None:
    data = tank(tmp_path / "unique.fmu", "UNIQUE").with_suffix(".so").read_bytes()
    assert [unique_symbols(data[:length]) for length in (0, 4, 64, len(data) // 2, len(data) - 1)] == [[]] * 5
    assert unique_symbols(data[:4] + b"\1" + data[5:]) == []


@linux
def test_instances_share_no_global_variables_of_further_libraries(tmp_path: Path) -> None:
    library = further(tmp_path, "libfurther.so.1", "({ static int calls; (double)++calls; })")
    beside = {binary("further").replace("further.so", library.name): library}
    fmu = tank(tmp_path / "tank.fmu", "FURTHER", "GLOBAL", options=[str(library)], members=beside)
    library.unlink()
    assert runs(fmu, fmu) == [[1.0, 2.0]] * 3


# Further libraries


def further(folder: Path, name: str, scale: str, *options: str, soname: bool = True) -> Path:
    """A library with the function `further`."""
    source = folder / f"{name}.c"
    source.write_text(f"double deeper(void);\ndouble further(void);\ndouble further(void) {{ return {scale}; }}\n")
    return compile_c(source, folder / name, *([f"-Wl,-soname,{name}"] if soname else []), *options)


@linux
def test_further_libraries_beside_it_are_found(tmp_path: Path) -> None:
    """The loader looks for them in the FMU's folder only if the library says so (RUNPATH)."""
    library = further(tmp_path, "libfurther.so.1", "3.0")
    beside = {binary("further").replace("further.so", library.name): library}
    fmu = tank(tmp_path / "tank.fmu", "FURTHER", options=[str(library)], members=beside)
    library.unlink()
    assert levels(fmu, fmu) == [3.0, 6.0]


@linux
def test_libraries_of_further_libraries_are_found(tmp_path: Path) -> None:
    (tmp_path / "deeper.c").write_text("double deeper(void);\ndouble deeper(void) { return 5.0; }\n")
    deeper = compile_c(tmp_path / "deeper.c", tmp_path / "libdeeper.so", "-Wl,-soname,libdeeper.so")
    library = further(tmp_path, "libfurther.so.1", "deeper()", str(deeper))
    folder = str(Path(binary("tank")).parent)
    members = {f"{folder}/{file.name}": file for file in (deeper, library)}
    fmu = tank(tmp_path / "tank.fmu", "FURTHER", options=[str(library), "-Wl,--allow-shlib-undefined"], members=members)
    library.unlink()
    deeper.unlink()
    assert levels(fmu) == [5.0]


@linux
def test_a_further_library_that_is_nowhere_is_named(tmp_path: Path) -> None:
    library = further(tmp_path, "libfurther.so.1", "3.0")
    fmu = tank(tmp_path / "tank.fmu", "FURTHER", options=[str(library)])
    library.unlink()
    message = refusal(fmu)
    assert "can't be loaded: its library tank.so needs libfurther.so.1, which is neither beside it nor on" in message
    assert "package libfurther1" in message
    assert "LD_LIBRARY_PATH" in message


@linux
def test_a_further_library_without_a_name_is_refused(tmp_path: Path) -> None:
    """The loader takes a library that is there by its name; one without is looked for again."""
    library = further(tmp_path, "libfurther.so", "3.0", soname=False)
    beside = {binary("further").replace("further.so", library.name): library}
    options = [f"-L{tmp_path}", "-lfurther"]
    message = refusal(tank(tmp_path / "tank.fmu", "FURTHER", options=options, members=beside))
    assert "needs libfurther.so, which lies beside it, but has no name of its own" in message


# What the loader refuses


@linux
def test_a_function_that_no_library_has_is_named(tmp_path: Path) -> None:
    message = refusal(tank(tmp_path / "tank.fmu", "NOWHERE"))
    assert "can't be loaded: its library tank.so calls 'nowhere', which neither it nor a library" in message


def rebuilt(tmp_path: Path, library: bytes) -> Path:
    """The tank with another library."""
    path = tmp_path / "other.fmu"
    with zipfile.ZipFile(tank(tmp_path / "tank.fmu")) as archive:
        return packed(path, archive.read("modelDescription.xml").decode(), {binary("tank"): library})


@linux
@pytest.mark.parametrize(("machine", "name"), [(3, "32-bit x86"), (40, "32-bit ARM"), (243, "RISC-V")])
def test_a_library_for_another_processor_says_so(tmp_path: Path, machine: int, name: str) -> None:
    data = bytearray(tank(tmp_path / "tank.fmu").with_suffix(".so").read_bytes())
    data[18] = machine
    assert f"its library tank.so is for {name} Linux, and this process is" in refusal(rebuilt(tmp_path, bytes(data)))


@linux
@pytest.mark.parametrize(("data", "name"), [(b"MZ", "Windows"), (b"\xcf\xfa\xed\xfe", "macOS")])
def test_a_library_for_another_system_says_so(tmp_path: Path, data: bytes, name: str) -> None:
    assert f"is for {name}, and this process is" in refusal(rebuilt(tmp_path, data + bytes(64)))


@linux
def test_a_damaged_library_says_so(tmp_path: Path) -> None:
    whole = tank(tmp_path / "tank.fmu").with_suffix(".so").read_bytes()
    assert "its library tank.so is damaged" in refusal(rebuilt(tmp_path, whole[:60]))


@pytest.mark.parametrize(
    ("said", "cause"),
    [
        ("{path}: failed to map segment from shared object: Operation not permitted", "noexec.*TMPDIR"),
        ("{path}: failed to map segment from shared object", "noexec.*TMPDIR"),
        ("/lib/libc.so.6: version `GLIBC_2.99' not found (required by {path})", r"newer system.*GLIBC_2\.99"),
        ("/lib/libstdc++.so.6: version `GLIBCXX_3.4.99' not found (required by {path})", r"GLIBCXX_3\.4\.99"),
        ("{path}: cannot enable executable stack as shared object requires: Invalid argument", "patchelf"),
        ("{path}: cannot allocate memory in static TLS block", "GLIBC_TUNABLES"),
        ("libgfortran.so.3: cannot open shared object file: No such file or directory", "package libgfortran3"),
        ("libxml2.so.2: cannot open shared object file: No such file or directory", "package libxml2-2"),
        (
            "Error loading shared library libgomp.so.1: No such file or directory (needed by {path})",
            "needs libgomp.so.1",
        ),
        ("dlopen({path}, 0x0006): Library not loaded: @rpath/libgomp.1.dylib\n  Referenced from: x", "needs libgomp.1"),
        ("[WinError 126] The specified module could not be found", "needs a further DLL"),
        ("something else", "something else$"),
    ],
)
def test_what_the_loader_says_becomes_cause_and_remedy(said: str, cause: str) -> None:
    path = Path(sys.executable)  # a file for this system
    message = why_not_loaded(said.format(path=path), path)
    assert message.startswith(f"can't be loaded: its library {path.name}")
    assert re.search(cause, message), message


# What there is for this machine


def test_the_platforms_that_an_fmu_has_are_named(tmp_path: Path) -> None:
    members = {
        "binaries/amiga/tank.library": b"",
        "binaries/win16/tank.dll": b"",
        "binaries/": b"",
        "binaries/notes": b"",
    }
    fmu = packed(tmp_path / "tank.fmu", description_of_tank(), members)
    assert f"has no binary for {fmpy.platform} (it has: amiga, win16); get one" in refusal(fmu)
    assert "--build" not in refusal(fmu)
    assert "has no binary" in refusal(fmu, build=True)
    assert "(it has: none)" in refusal(packed(tmp_path / "none.fmu", description_of_tank(), {}))


def test_a_library_of_another_name_is_named(tmp_path: Path) -> None:
    fmu = packed(tmp_path / "tank.fmu", description_of_tank(), {binary("Tank"): b""})
    assert f"has no {binary('tank')}, which its model identifier asks for (it has Tank" in refusal(fmu)


@pytest.mark.parametrize("version", ["3.0-beta.3", "3.0-rc.1"])
def test_an_fmu_of_a_draft_is_refused_before_its_library_is_called(tmp_path: Path, gain3c: Path, version: str) -> None:
    fmu = redescribed(gain3c, tmp_path / "draft.fmu", {'fmiVersion="3.0"': f'fmiVersion="{version}"'})
    assert f"is of FMI {version}, a draft with other functions than FMI 3.0; export it again" in refusal(fmu)


# C sources


@pytest.mark.parametrize("listed", ["tank.c", ""])
def test_c_sources_are_compiled_on_request(tmp_path: Path, listed: str) -> None:
    fmu = sources_of_tank(tmp_path / "tank.fmu", listed=listed)
    assert refusal(fmu).endswith("or compile its C sources: --build (pytest: --fmu-build; in Python: build=True)")
    assert levels(fmu, fmu, build=True) == [1.0, 2.0]
    assert levels(tank(tmp_path / "binary.fmu"), build=True) == [1.0]


def test_c_sources_take_the_place_of_a_library_that_cannot_be_loaded(tmp_path: Path) -> None:
    fmu = sources_of_tank(tmp_path / "tank.fmu", members={binary("tank"): b"no library"})
    assert "can't be loaded" in refusal(fmu)
    assert levels(fmu, build=True) == [1.0]


def test_c_sources_that_the_compiler_refuses_give_its_first_error(tmp_path: Path) -> None:
    fmu = sources_of_tank(tmp_path / "tank.fmu", "int f(void) { return missing; }\n")
    message = refusal(fmu, build=True)
    assert re.search(r"can't be compiled: \S+ refuses its C sources: tank\.c:1:.* error: .*missing", message), message


@pytest.mark.parametrize("name", ["-o/tmp/elsewhere", "../../elsewhere.c", "/etc/passwd", "@options"])
def test_sources_are_names_of_files_of_the_fmu(tmp_path: Path, name: str) -> None:
    """And neither options of the compiler nor files elsewhere."""
    fmu = sources_of_tank(tmp_path / "tank.fmu", f"/* {name} */", listed=f"tank.c {name}")
    assert f"its list of sources has '{name}', which is not a name of one of its files" in refusal(fmu, build=True)


def test_without_a_compiler_the_message_says_how_to_get_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fmu = sources_of_tank(tmp_path / "tank.fmu", "/* what no test has compiled before */")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(cosim.fmi.compilation, "find_spec", lambda _: None)
    assert "no C compiler; install gcc or clang, or pip install ziglang" in refusal(fmu, build=True)
    monkeypatch.setenv("CC", "no-such-compiler -O3")
    assert "can't be compiled: no-such-compiler can't be started" in refusal(fmu, build=True)


def test_the_sources_of_fmi_3_are_those_of_the_build_description(tmp_path: Path, gain3c: Path) -> None:
    """With their definitions and further folders of headers."""
    text = Path(__file__).parents[1] / "support" / "fmi3_gain.c"
    build_description = (
        '<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="IDENTIFIER">'
        '<SourceFileSet language="C99"><SourceFile name="deep/gain.c"/><PreprocessorDefinition name="WITH" value="1"/>'
        '<IncludeDirectory name="headers"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>'
    )
    with zipfile.ZipFile(gain3c) as archive:
        description = archive.read("modelDescription.xml").decode()
    identifier = re.search('modelIdentifier="([^"]+)"', description).group(1)
    members = {
        "sources/buildDescription.xml": build_description.replace("IDENTIFIER", identifier),
        "sources/deep/gain.c": '#include "here.h"\n#if WITH + HERE != 3\n#error wrong\n#endif\n' + text.read_text(),
        "sources/headers/here.h": "#define HERE 2\n",
    }
    system = System()
    system.add("c", packed(tmp_path / "gain.fmu", description, members), start=HELD)
    with_binary = System()
    with_binary.add("c", gain3c, start=HELD)
    assert (simulate(system, 1.0, 0.5, build=True).values == simulate(with_binary, 1.0, 0.5).values).all()


# Folders


@pytest.fixture
def unsafe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files whose address has escaped characters."""
    folder = tmp_path / UNSAFE
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.parametrize("character", UNSAFE)
def test_characters_that_a_uri_escapes_are_known(character: str) -> None:
    assert not is_plain(Path(f"/tmp/a{character}b"))


def test_plain_paths_are_known() -> None:
    assert is_plain(Path("/tmp/A z09/-._~"))


def test_fmus_are_unpacked_in_a_folder_with_a_plain_path(unsafe: Path) -> None:
    with folder_for_fmus() as folder:
        assert is_plain(Path(folder))
        assert unsafe not in Path(folder).parents
    assert not Path(folder).exists()


def test_a_plain_folder_for_temporary_files_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with a space."""
    plain = tmp_path / "with a space"
    plain.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(plain))
    with folder_for_fmus() as folder:
        assert (Path(folder).parent == plain) == is_plain(tmp_path)


@pytest.mark.skipif(not hasattr(os, "ST_NOEXEC"), reason="only Linux says how a folder is mounted")
def test_a_folder_that_is_mounted_noexec_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here := tmp_path / "noexec").mkdir()
    mounted = os.statvfs

    def statvfs(path: Path) -> SimpleNamespace:
        return SimpleNamespace(f_flag=mounted(path).f_flag | (os.ST_NOEXEC if Path(path) == here else 0))

    monkeypatch.setattr(os, "statvfs", statvfs)
    monkeypatch.setattr(tempfile, "tempdir", str(here))
    with folder_for_fmus() as folder:
        assert Path(folder).parent != here


@pytest.mark.parametrize("name", [UNSAFE, "with a space", "plain"])
def test_fmus_find_their_resources_by_uri(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """In whichever folder; the URI is escaped as the standard wants it."""
    fmu = tank(tmp_path / "tank.fmu", "RESOURCE", members={"resources/scale.txt": "7.0"})
    (folder := tmp_path / name).mkdir()
    monkeypatch.setattr(cosim.master.loaded_components, "folder_for_fmus", lambda: TemporaryDirectory(dir=folder))
    assert levels(fmu) == [7.0]


_SCRIPT = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Constant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 42.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        return True
"""


def python_fmu(folder: Path, made: str) -> Path:
    """An FMU whose output is 42, made by the exporter for scripts or by pythonfmu itself."""
    script = folder / "constant_slave.py"
    script.write_text(_SCRIPT)
    return build_script(script, folder) if made == "script" else Path(FmuBuilder.build_FMU(script, dest=folder))


@pytest.mark.parametrize("made", ["script", "stock"])
def test_fmus_of_pythonfmu_run_where_the_temporary_folder_would_crash_them(
    unsafe: Path, tmp_path: Path, made: str
) -> None:
    """In a process of its own, which a crash would end."""
    fmu = python_fmu(tmp_path, made)
    script = (
        "import sys\nfrom cosim import System, simulate\nsystem = System()\n"
        "system.add('c', sys.argv[1])\nprint(simulate(system, 1.0, 0.5, record=['c.y'])['c.y'][-1])\n"
    )
    environment = {**os.environ, "TMPDIR": str(unsafe), "TEMP": str(unsafe), "TMP": str(unsafe)}
    done = subprocess.run(
        [sys.executable, "-c", script, str(fmu)], env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.strip()) == (0, "42.0"), done.stderr


@linux
@pytest.mark.parametrize("options", [(), ("-Wl,-rpath,$ORIGIN",)])
def test_further_libraries_of_one_name_are_those_of_their_fmus(tmp_path: Path, options: tuple[str, ...]) -> None:
    """The loader takes a library of that name that is there already, also where another one lies beside the FMU's."""
    fmus = []
    for scale in (3.0, 5.0):
        folder = tmp_path / str(scale)
        folder.mkdir()
        library = further(folder, "libfurther.so.1", str(scale))
        beside = {binary("further").replace("further.so", library.name): library}
        fmus.append(tank(folder / "tank.fmu", "FURTHER", options=[str(library), *options], members=beside))
        library.unlink()
    assert levels(*fmus) == [3.0, 10.0]

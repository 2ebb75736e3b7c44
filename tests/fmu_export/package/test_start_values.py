"""Start values are data: written into an FMU atomically, the same in the model description and in its instances."""

import math
import os
import re
import shutil
import stat
import threading
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from fmpy.validation import validate_fmu
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.package import archive as archive_module
from fmu_export.package.start_values import StartValueError, write_start_values
from tests.support import some
from tests.support.bare_host import fresh

DESCRIPTION = "modelDescription.xml"
TEXT = "resources/start_values.txt"


@pytest.fixture
def controller(fmus, tmp_path):
    """A copy of the controller, alone in its folder."""
    folder = tmp_path / "fmu"
    folder.mkdir()
    return Path(shutil.copy(fmus / "RobotController.fmu", folder))


def members(fmu):
    with zipfile.ZipFile(fmu) as archive:
        assert archive.testzip() is None
        return {info.filename: archive.read(info) for info in archive.infolist()}


def described(fmu):
    root = ET.fromstring(members(fmu)[DESCRIPTION])
    starts = {v.get("name"): v.find("Real").get("start") for v in root.iter("ScalarVariable")}
    return {name: start for name, start in starts.items() if start is not None}


def in_text(fmu):
    return dict(line.split(" = ") for line in members(fmu)[TEXT].decode().splitlines())


def unchanged(fmu, before: bytes):
    """The file is as it was, and nothing lies beside it."""
    assert fmu.read_bytes() == before
    assert [p.name for p in fmu.parent.iterdir()] == [fmu.name]


REPORT = """
import fmpy
from fmpy.fmi2 import FMU2Slave
description = fmpy.read_model_description(A.fmu)
slave = FMU2Slave(guid=description.guid, unzipDirectory=str(fmpy.extract(A.fmu, os.path.abspath("x"))),
                  modelIdentifier=description.coSimulation.modelIdentifier, instanceName="x")
slave.instantiate()
slave.setupExperiment()
slave.enterInitializationMode()
slave.exitInitializationMode()
known = [v for v in description.modelVariables if v.causality != "output"]
values = slave.getReal([v.valueReference for v in known])
outputs = slave.getReal([v.valueReference for v in description.modelVariables if v.causality == "output"])
slave.terminate()
slave.freeInstance()
report([{v.name: [value, float(v.start)] for v, value in zip(known, values)}, outputs])
"""


def test_description_text_and_instance_have_the_new_values(controller, tmp_path):
    new = {"alpha": 0.1, "psi_start[2]": -1.0 / 3.0, "max_step": 5e-4, "S[1]": 3}
    before = described(controller)
    write_start_values(controller, new)
    expected = before | {name: repr(float(value)) for name, value in new.items()}
    assert described(controller) == expected
    assert in_text(controller) == expected
    reported, outputs = fresh(tmp_path, REPORT, fmu=controller)
    for name, (value, start) in some(reported.items()):
        assert repr(value) == repr(start) == expected[name]
    assert outputs[-1] == -1.0 / 3.0  # psi[2] starts where psi_start[2] says


def test_the_result_is_a_valid_fmu(controller):
    write_start_values(controller, {"alpha": 2.0})
    assert validate_fmu(str(controller)) == []


def test_all_else_stays_byte_for_byte(controller):
    before = members(controller)
    with zipfile.ZipFile(controller) as archive:
        infos = {i.filename: (i.date_time, i.compress_type, i.external_attr) for i in archive.infolist()}
        order = archive.namelist()
    write_start_values(controller, {"beta": 1.25})
    after = members(controller)
    assert {n: d for n, d in after.items() if n not in (DESCRIPTION, TEXT)} == {
        n: d for n, d in before.items() if n not in (DESCRIPTION, TEXT)
    }
    with zipfile.ZipFile(controller) as archive:
        assert archive.namelist() == order
        assert {i.filename: (i.date_time, i.compress_type, i.external_attr) for i in archive.infolist()} == infos
    # the model description differs in one attribute only
    xml = re.compile(r'(name="beta".*?start=")[^"]*', re.S)
    old, new = before[DESCRIPTION].decode(), after[DESCRIPTION].decode()
    assert old != new
    assert xml.sub(r"\g<1>1.25", old, count=1) == new
    assert before[TEXT].splitlines()[2:] == after[TEXT].splitlines()[2:]


def test_writing_the_old_value_back_restores_every_byte(controller):
    before = controller.read_bytes()
    alpha = CONTROLLER.parameters.unpack(CONTROLLER.parameters.starts).alpha
    write_start_values(controller, {"alpha": 0.5})
    assert controller.read_bytes() != before
    write_start_values(controller, {"alpha": float(alpha)})
    assert controller.read_bytes() == before


def test_permissions_stay(controller):
    controller.chmod(0o640)
    write_start_values(controller, {"alpha": 0.5})
    assert stat.S_IMODE(controller.stat().st_mode) == 0o640


def test_comment_of_the_archive_stays(controller):
    with zipfile.ZipFile(controller, "a") as archive:
        archive.comment = b"a comment"
    write_start_values(controller, {"alpha": 0.5})
    with zipfile.ZipFile(controller) as archive:
        assert archive.comment == b"a comment"


def test_writing_nothing_changes_nothing(controller):
    before = members(controller)
    write_start_values(controller, {})
    assert members(controller) == before


@given(st.floats(0.0, allow_infinity=False, allow_nan=False))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_finite_value_reads_back_bit_for_bit(controller, value):
    write_start_values(controller, {"beta": value})
    for starts in (described(controller), in_text(controller)):
        assert repr(float(starts["beta"])) == repr(value)


@pytest.mark.parametrize("number", [2, True])
def test_numbers_of_other_types_become_floats(controller, number):
    import numpy as np

    write_start_values(controller, {"alpha": np.float64(0.1), "beta": number, "k": np.int64(3)})
    for starts in (described(controller), in_text(controller)):
        assert (starts["alpha"], starts["beta"], starts["k"]) == ("0.1", repr(float(number)), "3.0")


# Refusals


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"gamma": 1.0}, r"no parameter 'gamma'; its parameters are alpha, beta"),
        ({"theta_a[1]": 1.0}, r"no parameter 'theta_a\[1\]'"),  # an input
        ({"tau_a[1]": 1.0}, r"no parameter 'tau_a\[1\]'"),  # an output
        ({"S": 1.0}, r"no parameter 'S'.*S\[1\]"),  # whole vectors are not scalars
        ({"": 1.0}, r"no parameter ''"),
        ({"alpha": math.nan}, r"'alpha' is nan, which is not a finite number"),
        ({"alpha": math.inf}, r"'alpha' is inf, which is not a finite number"),
        ({"alpha": -1e-300}, r"-1e-300 of 'alpha' is outside \[0.0, inf\]"),
        ({"k": 0.0}, r"0.0 of 'k' is outside \[1e-12, inf\]"),
        ({"max_step": 0.0}, r"'max_step' is outside"),
        ({"alpha": 1.0, "beta": 2.0, "k": -1.0}, r"'k' is outside"),  # the first two are not written either
    ],
)
def test_wrong_values_are_refused_and_nothing_is_written(controller, values, message):
    before = controller.read_bytes()
    with pytest.raises(StartValueError, match=message) as caught:
        write_start_values(controller, values)
    assert str(controller) in str(caught.value)
    assert "\n" not in str(caught.value)
    unchanged(controller, before)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 damaged", bytes(1000)])
def test_what_is_no_zip_is_refused(tmp_path, content):
    file = tmp_path / "fmu" / "x.fmu"
    file.parent.mkdir()
    file.write_bytes(content)
    with pytest.raises(StartValueError, match=r"x\.fmu: not an FMU"):
        write_start_values(file, {"alpha": 1.0})
    unchanged(file, content)


def test_a_cut_fmu_is_refused(controller):
    content = controller.read_bytes()[:-100]
    controller.write_bytes(content)
    with pytest.raises(StartValueError, match="not an FMU"):
        write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, content)


def without(fmu, member):
    files = members(fmu)
    del files[member]
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return fmu.read_bytes()


@pytest.mark.parametrize("member", [TEXT, DESCRIPTION])
def test_an_fmu_of_another_kind_is_refused(controller, member):
    before = without(controller, member)
    with pytest.raises(StartValueError, match=rf"(?s)no member.*{re.escape(member)}.*build_fmus.py"):
        write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, before)


@pytest.mark.parametrize(
    ("member", "data"),
    [
        (TEXT, b"alpha 1.0\n"),
        (TEXT, b"alpha = one\n"),
        (TEXT, b"\xff\xfe"),
        (DESCRIPTION, b"<fmiModelDescription>"),
        (DESCRIPTION, b"\xff\xfe"),
    ],
)
def test_unreadable_contents_are_refused_with_the_name_of_the_file(controller, member, data):
    files = members(controller) | {member: data}
    with zipfile.ZipFile(controller, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    before = controller.read_bytes()
    with pytest.raises(StartValueError, match=re.escape(str(controller))):
        write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, before)


def test_a_damaged_member_is_refused(controller):
    """A flipped bit in a member is found by its checksum before anything is written."""
    content = bytearray(controller.read_bytes())
    with zipfile.ZipFile(controller) as archive:
        info = archive.getinfo(f"binaries/linux64/{CONTROLLER.name}.so")
    content[info.header_offset + 1000] ^= 0xFF
    controller.write_bytes(content)
    with pytest.raises((zipfile.BadZipFile, StartValueError, OSError)):
        write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, bytes(content))


def test_missing_file_folder_instead_of_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_start_values(tmp_path / "none.fmu", {"alpha": 1.0})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OSError, match="directory"):
        write_start_values(tmp_path, {"alpha": 1.0})


# Atomicity


class Injected(OSError):
    """The failure a test makes."""


def fail(*arguments, **keywords):
    raise Injected("no space left on device")


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (Path, "replace"),
        (os, "fsync"),
        (archive_module.tempfile, "mkstemp"),
        (zipfile.ZipFile, "writestr"),
        (Path, "chmod"),
    ],
)
def test_failure_half_way_leaves_the_old_file_and_no_other(controller, monkeypatch, owner, name):
    before = controller.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, fail)
        with pytest.raises(Injected):
            write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, before)
    write_start_values(controller, {"alpha": 1.0})
    assert described(controller)["alpha"] == "1.0"


def test_failure_at_any_member_leaves_the_old_file(controller, monkeypatch):
    before, original = controller.read_bytes(), zipfile.ZipFile.writestr
    for count in range(1, len(members(controller)) + 1):
        calls = []

        def writestr(self, *arguments, calls=calls, count=count):
            calls.append(arguments)
            if len(calls) == count:
                raise Injected
            return original(self, *arguments)

        with monkeypatch.context() as patch:
            patch.setattr(zipfile.ZipFile, "writestr", writestr)
            with pytest.raises(Injected):
                write_start_values(controller, {"alpha": 1.0})
        unchanged(controller, before)


def test_interrupt_leaves_the_old_file(controller, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    before = controller.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_start_values(controller, {"alpha": 1.0})
    unchanged(controller, before)


def test_a_failing_build_leaves_the_old_fmu(controller, monkeypatch):
    from fmu_export.pythonfmu.backend import build_pythonfmu

    before = controller.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", fail)
        with pytest.raises(Injected):
            build_pythonfmu(CONTROLLER, controller.parent)
    unchanged(controller, before)


@pytest.mark.slow
def test_whoever_reads_while_it_is_written_sees_one_whole_fmu(controller):
    """Not a mixture either: both places always hold the same number."""
    stop, seen, failures = threading.Event(), set(), []

    def read():
        try:
            while not stop.is_set():
                with zipfile.ZipFile(controller) as archive:
                    xml, text = archive.read(DESCRIPTION).decode(), archive.read(TEXT).decode()
                one = re.search(r'name="alpha".*?start="([^"]*)"', xml, re.S)[1]
                other = re.search(r"^alpha = (.*)$", text, re.M)[1]
                assert one == other
                seen.add(one)
        except BaseException as error:
            failures.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    for i in range(20):
        write_start_values(controller, {"alpha": float(i)})
    stop.set()
    reader.join()
    assert failures == []
    assert len(seen) > 1


def test_write_through_a_symbolic_link_keeps_the_link(controller, tmp_path):
    """A link to an FMU stays one, and what it points to is changed."""
    link = tmp_path / "link.fmu"
    link.symlink_to(controller)
    write_start_values(link, {"alpha": 0.75})
    assert described(link)["alpha"] == "0.75"
    assert link.is_symlink()
    assert described(controller)["alpha"] == "0.75"

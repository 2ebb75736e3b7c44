"""`cosim validate`: one line a finding, exit code 1 on any."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cosim.__main__ import main

NAMES = ["RobotPlant", "RobotController", "RobotTrajectory"]
DESCRIPTION = "modelDescription.xml"


@pytest.fixture
def here(fmus: Path, tmp_path, monkeypatch) -> Path:
    for path in fmus.glob("*.fmu"):
        shutil.copyfile(path, tmp_path / path.name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rewrite(path: Path, change: Callable[[str], str]) -> None:
    """Change the model description of an FMU and nothing else."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    old = members[DESCRIPTION].decode("utf-8")
    new = change(old)
    assert new != old
    members[DESCRIPTION] = new.encode("utf-8")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)


def cut(xml: str, first: str, last: str) -> str:
    """The text without the part from `first` to the end of `last`."""
    head, _, rest = xml.partition(first)
    return head + rest.partition(last)[2]


def test_the_three_fmus_are_in_order(here, capsys):
    assert main(["validate", *(f"{name}.fmu" for name in NAMES)]) == 0
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [f"{name}.fmu: ok" for name in NAMES]
    assert shown.err == ""


def test_an_fmu_packed_anew_without_a_change_is_in_order(here, capsys):
    # so that the findings below come from the defects, not from the packing
    rewrite(here / "RobotPlant.fmu", lambda xml: xml + "\n")
    assert main(["validate", "RobotPlant.fmu"]) == 0
    assert capsys.readouterr().out == "RobotPlant.fmu: ok\n"


DEFECTS = {
    "no InitialUnknowns": lambda xml: cut(xml, "<InitialUnknowns>", "</InitialUnknowns>"),
    "a unit that is not defined": lambda xml: xml.replace('unit="N.m"', 'unit="N.mm"', 1),
    "no guid": lambda xml: xml.replace("guid=", "gu=", 1),
    "an element out of place": lambda xml: xml.replace("<ModelVariables>", "<ModelVariables><Nothing/>"),
    "a name twice": lambda xml: xml.replace('name="y_E_start"', 'name="x_E_start"'),
    "no start value": lambda xml: xml.replace(' start="1.2525"', "", 1),
}


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_found_and_is_one_line(here, capsys, defect):
    rewrite(here / "RobotPlant.fmu", DEFECTS[defect])
    assert main(["validate", "RobotPlant.fmu"]) == 1
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert lines
    for line in lines:
        assert line.startswith("RobotPlant.fmu: ")
        assert line != "RobotPlant.fmu: ok"
    assert "Traceback" not in shown.out + shown.err


def test_the_finding_names_the_defect(here, capsys):
    rewrite(here / "RobotPlant.fmu", DEFECTS["a unit that is not defined"])
    assert main(["validate", "RobotPlant.fmu"]) == 1
    assert "N.mm" in capsys.readouterr().out


def test_a_missing_file_is_found_and_the_others_are_still_checked(here, capsys):
    assert main(["validate", "nowhere.fmu", "RobotPlant.fmu"]) == 1
    assert capsys.readouterr().out.splitlines() == ["nowhere.fmu: there is no such file", "RobotPlant.fmu: ok"]


def test_a_folder_is_found(here, capsys):
    (here / "folder.fmu").mkdir()
    assert main(["validate", "folder.fmu"]) == 1
    assert capsys.readouterr().out.startswith("folder.fmu: ")


@pytest.mark.parametrize("damage", ["text", "empty", "truncated"])
def test_what_is_no_archive_is_found_and_the_others_are_still_checked(here, capsys, damage):
    content = (here / "RobotPlant.fmu").read_bytes()
    damaged = {"text": b"no archive", "empty": b"", "truncated": content[: len(content) // 2]}[damage]
    Path("bad.fmu").write_bytes(damaged)
    assert main(["validate", "bad.fmu", "RobotPlant.fmu"]) == 1
    shown = capsys.readouterr()
    lines = shown.out.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["bad.fmu", "RobotPlant.fmu"]
    assert "zip" in lines[0]
    assert lines[1].endswith(": ok")
    assert shown.err == ""


@pytest.mark.parametrize("xml", [None, "", "no xml", "<fmiModelDescription/>"])
def test_an_archive_without_a_readable_description_is_found(here, capsys, xml):
    with zipfile.ZipFile("bad.fmu", "w") as archive:
        archive.writestr("other", "")
        if xml is not None:
            archive.writestr(DESCRIPTION, xml)
    assert main(["validate", "bad.fmu"]) == 1
    shown = capsys.readouterr()
    assert shown.err == ""
    assert all(line.startswith("bad.fmu: ") for line in shown.out.splitlines())
    assert shown.out.count("\n") >= 1


def test_no_file_at_all_is_exit_code_2(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["validate"])
    assert ended.value.code == 2

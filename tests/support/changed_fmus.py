"""Copies of FMUs in which something is changed."""

import re
import zipfile
from pathlib import Path


def rewritten(source: Path, target: Path, **new: str | bytes | None) -> Path:
    """Copy an FMU with `pattern=replacement` in its description, or members changed (None: dropped)."""
    description = new.pop("description", None)
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as archive:
        for name in old.namelist():
            data: bytes | str | None = old.read(name)
            if name == "modelDescription.xml" and isinstance(description, str):
                before, after = description.split(" => ")
                assert before.encode() in data
                data = data.replace(before.encode(), after.encode())
            for part, change in new.items():
                if part in name:
                    data = change
            if data is not None:
                archive.writestr(name, data)
    return target


def in_millimetres(fmu: Path, out: Path, *attributes: str, relative: bool = False) -> Path:
    """The same FMU with its lengths in mm."""
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    unit = re.compile(r'<Unit name="m">\s*<BaseUnit m="1"')
    assert unit.search(text)
    text = unit.sub('<Unit name="mm"><BaseUnit m="1" ' + " ".join(attributes), text)
    text = text.replace('unit="m"', 'declaredType="Difference"' if relative else 'unit="mm"')
    difference = '<SimpleType name="Difference"><Real unit="mm" relativeQuantity="true"/></SimpleType>'
    types = f"<TypeDefinitions>{difference}</TypeDefinitions>"
    text = text.replace("</UnitDefinitions>", "</UnitDefinitions>" + types)
    return rewritten(fmu, out, **{"modelDescription.xml": text})

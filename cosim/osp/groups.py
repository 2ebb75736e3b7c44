"""Groups of variables, which an FMU has by its `OspModelDescription.xml`: ports, forces, vectors and others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from cosim.errors import nearest
from cosim.files.xml_elements import children, local_name
from cosim.osp.errors import OSPError
from cosim.osp.parsing import attribute, parse


@dataclass(frozen=True)
class Group:
    """A group: variables, or groups, or both; each in the order in which it is connected."""

    name: str
    variables: tuple[str, ...]
    groups: tuple[Group, ...]

    def find(self, name: str) -> Group | None:
        """The group of that name, which may be this one or one in it."""
        if self.name == name:
            return self
        return next((found for g in self.groups if (found := g.find(name)) is not None), None)


def read_groups(simulator: str, model: str, folders: Sequence[Path]) -> Group:
    """All groups of an FMU, as one.

    Parameters
    ----------
    simulator : str
        For messages.
    model : str
        Name of the FMU's model, with which the name of the file begins.
    folders : sequence of Path
        Where the file may be: that of the FMU, and that of the configuration.

    Raises
    ------
    OSPError
        There is no such file, or it is malformed.
    """
    file = f"{model}_OspModelDescription.xml"
    for folder in folders:
        if (folder / file).is_file():
            here = f"{folder / file}"
            root = parse(folder / file, "OspModelDescription")
            holder = next(children(root, "VariableGroups"), None)
            return Group("", (), tuple(_group(g, here) for g in (holder if holder is not None else ())))
    raise OSPError(
        f"simulator '{simulator}' has no variable groups: there is no {file} beside its FMU or the configuration"
    )


def _group(element: ElementTree.Element, here: str) -> Group:
    variables = tuple(attribute(v, "ref", here) for v in children(element, "Variable"))
    groups = tuple(_group(g, here) for g in element if local_name(g) != "Variable")
    return Group(attribute(element, "name", here), variables, groups)


def found_in(groups: Group, name: str, here: str) -> Group:
    """The group of a name.

    Raises
    ------
    OSPError
        There is none.
    """
    found = next((g for inner in groups.groups if (g := inner.find(name)) is not None), None)
    if found is None:
        known = [g.name for g in groups.groups]
        raise OSPError(f"{here}: there is no variable group '{name}'; {nearest(name, known)}")
    return found


def pairs(a: Group, b: Group, here: str) -> list[tuple[str, str]]:
    """The variables of two groups that belong together.

    Raises
    ------
    OSPError
        The groups are of different sizes.
    """
    if (len(a.variables), len(a.groups)) != (len(b.variables), len(b.groups)):
        raise OSPError(
            f"{here}: '{a.name}' has {len(a.variables)} variables and {len(a.groups)} groups, '{b.name}' "
            f"{len(b.variables)} and {len(b.groups)}; only groups of one structure can be connected"
        )
    found = list(zip(a.variables, b.variables, strict=True))
    for inner_a, inner_b in zip(a.groups, b.groups, strict=True):
        found += pairs(inner_a, inner_b, here)
    return found

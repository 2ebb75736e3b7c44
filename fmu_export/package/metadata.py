"""Who made a model and under which terms, for the model description and the documentation of its FMU."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

from fmu_export.errors import DocumentationError
from fmu_export.modelling.names import check_text
from fmu_export.package.description_common import DISTRIBUTION


@dataclass(frozen=True)
class Metadata:
    """Who made a model and under which terms; what is empty is left out.

    Parameters
    ----------
    author : str, optional
        Name and organisation.
    version : str, optional
        Of the model.
    copyright : str, optional
        For example "(c) 2027 Example Ltd.".
    license : str, optional
        Name of the licence, such as "MIT" or "proprietary".
    license_text : str, optional
        Its text, which becomes `documentation/licenses/license.txt`.

    Raises
    ------
    ArgumentError
        One of the first four is no line of printable text.
    """

    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    license_text: str = ""

    def __post_init__(self) -> None:
        for name, value in self.attributes.items():
            check_text(f"metadata: {name}", value)

    @property
    def attributes(self) -> dict[str, str]:
        """Attributes of a model description, in FMI's order."""
        given = {name: getattr(self, name) for name in ("author", "version", "copyright", "license")}
        return {name: value for name, value in given.items() if value != ""}


#: Of a model that says nothing.
NO_METADATA = Metadata()


def licence_members(metadata: Metadata) -> dict[str, bytes]:
    """The licences in an archive: that of the model, and that of the code around it, which is ours.

    Raises
    ------
    DocumentationError
        Our licence is not found.
    """
    own = project_licence()
    found = {"documentation/licenses/license.txt": metadata.license_text} if metadata.license_text else {}
    if metadata.license_text != own:
        found[f"documentation/licenses/{DISTRIBUTION}.txt"] = own
    return {name: text.encode() for name, text in found.items()}


@cache
def project_licence() -> str:
    """Text of this project's licence: from the installed distribution, or from the checkout.

    Raises
    ------
    DocumentationError
        It is in neither.
    """
    try:
        installed = [Path(str(f.locate())) for f in files(DISTRIBUTION) or () if f.name == "LICENSE"]
    except PackageNotFoundError:
        installed = []
    checkout = Path(__file__).resolve().parents[2] / "LICENSE"
    for path in (*installed, checkout):
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise DocumentationError(
        f"the licence is neither in the installed distribution {DISTRIBUTION} nor at {checkout}: reinstall the package"
    )

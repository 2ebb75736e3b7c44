"""The XML files of an OSP configuration; documents that define entities are refused."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree
from xml.parsers import expat

from cosim.files.xml_elements import local_name
from cosim.osp.errors import OSPError

#: XML files that are larger are refused: they would not fit into memory once decoded.
MOST_XML_BYTES = 64 * 1024**2


def parse(path: Path, root: str) -> ElementTree.Element:
    """Root element of a file.

    Parameters
    ----------
    path : Path
    root : str
        Name that it must have, without a namespace.

    Raises
    ------
    OSPError
        There is no such file, it is no such XML, too large, or defines entities.
    """
    try:
        size = path.stat().st_size
        if size > MOST_XML_BYTES:
            raise OSPError(f"{path}: has {size} bytes, more than any such file needs; not opened")
        data = path.read_bytes()
    except OSError as error:
        raise OSPError(f"{path}: can't be read: {error.strerror or error}; check the path") from None
    try:
        _refuse_entities(data, path)
        element = ElementTree.fromstring(data)
    except (ElementTree.ParseError, expat.ExpatError, ValueError, LookupError) as error:
        raise OSPError(f"{path}: not readable as XML: {error}") from None
    if local_name(element) != root:
        raise OSPError(f"{path}: is not an {root}, but a {local_name(element)}; check the path")
    return element


def _refuse_entities(data: bytes, path: Path) -> None:
    def refuse(*_: object) -> NoReturn:
        raise OSPError(f"{path}: has a document type, which could define entities; remove it")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(data, True)


def attribute(element: ElementTree.Element, name: str, here: str) -> str:
    """An attribute that an element must have.

    Raises
    ------
    OSPError
        It has none.
    """
    value = element.get(name)
    if value is None:
        raise OSPError(f"{here}: a {local_name(element)} has no {name}; give it one")
    return value


def number(text: str, what: str) -> float:
    """A number.

    Raises
    ------
    OSPError
        The text is none.
    """
    try:
        return float(text)
    except ValueError:
        raise OSPError(f"{what} is '{text.strip()}', which is not a number; correct it") from None

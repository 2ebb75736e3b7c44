"""XML files of others, read within limits: no entities, no document types, nothing that is nested without end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cosim.errors import SetupError

if TYPE_CHECKING:
    from lxml.etree import _Element

#: Larger XML files are refused: they would not fit into memory once read.
MOST_XML_BYTES = 128 * 1024**2

#: Elements below more others than this are refused; no schema that is read here has more than 20.
_MOST_NESTED = 100


class XmlError(SetupError):
    """A file can't be read as XML; the text is to follow its name."""


def read_xml(data: bytes) -> _Element:
    """Root element of an XML file, without comments and processing instructions.

    Parameters
    ----------
    data : bytes
        In any encoding that the file names.

    Raises
    ------
    XmlError
        It is not XML, too large, nested too deep, or has a document type, which could define entities.
    """
    from lxml import etree  # later, as it takes a while and not every command reads XML

    if len(data) > MOST_XML_BYTES:
        raise XmlError(f"has {len(data)} bytes, more than any such file needs; not opened")
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True, remove_pis=True
    )
    try:
        root = etree.fromstring(data, parser)
    except (etree.LxmlError, ValueError, LookupError) as error:
        said = " ".join(str(getattr(error, "msg", None) or error).split())
        raise XmlError(f"is not readable as XML: {said or 'it is empty'}; correct it") from None
    if root.getroottree().docinfo.doctype:
        raise XmlError("has a document type (DOCTYPE), which could define entities; remove it")
    if root.xpath(f"boolean({'/*' * _MOST_NESTED})"):
        raise XmlError(f"has elements that are nested more than {_MOST_NESTED} times; no such file needs that")
    return root

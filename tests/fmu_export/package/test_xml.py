"""XML as bytes: what ElementTree writes, faster."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from fmu_export.package.description_common import to_bytes


def test_elements_are_written_as_by_the_standard_library():
    root = ET.Element("root", {"a": 'quote " and <&>', "line": "one\ntwo\r\tthree", "name": "Größe ° \ud800"})
    child = ET.SubElement(root, "child", empty="")
    ET.SubElement(child, "grandchild").text = 'text with "<&>" and\na line'
    ET.SubElement(root, "last").text = ""
    mixed = ET.SubElement(root, "mixed")
    ET.SubElement(mixed, "b").tail = "tail & more"
    written = to_bytes(root)  # which indents it
    assert written == ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
    assert b"&#10;two" in written


def test_elements_of_a_namespace_declare_it():
    root = ET.Element("{urn:example}root")
    ET.SubElement(root, "child", {"{urn:other}a": "1"})
    read = ET.fromstring(to_bytes(root))
    assert [read.tag, *read[0].keys()] == ["{urn:example}root", "{urn:other}a"]

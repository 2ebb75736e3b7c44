"""What the FMUs say about themselves, made and taken apart again."""

from html.parser import HTMLParser
from pathlib import Path

import fmpy
from lxml import etree

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.package.description_common import package_version
from fmu_export.package.documentation import documentation_members, figures_of
from fmu_export.package.interface import interface_of
from fmu_export.package.metadata import Metadata, licence_members, project_licence
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT
from tests.support import CHECKOUT
from trajectory_fmu.model import MODEL as TRAJECTORY

PAGES = {"RobotPlant": "plant_fmu", "RobotController": "controller_fmu", "RobotTrajectory": "trajectory_fmu"}


MODELS = {m.name: m for m in (PLANT, CONTROLLER, TRAJECTORY)}


#: Elements of HTML that have no end tag.
VOID = {"meta", "br", "img", "hr", "link", "input"}


def page_of(name):
    return (CHECKOUT / PAGES[name] / "README.md").read_text(encoding="utf-8")


def members_of(model, page="# Title", flavour="fmi3", figures=None):
    if figures is None and model.name in PAGES:
        figures = figures_of(page, CHECKOUT / PAGES[model.name])
    own = Metadata(version=package_version(), license="MIT", license_text=project_licence())
    members = documentation_members(model, interface_of(trace(model)), page, flavour, figures, own)
    return members | licence_members(own)


class Page(HTMLParser):
    """Elements of a page; fails on tags that don't match."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.text = [], [], {}
        self.rows = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        for tag in set(self.open):
            self.text[tag] = self.text.get(tag, "") + data
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def attributes(self, name):
        return [(tag, attrs[name]) for tag, attrs in self.elements if name in attrs]


def parsed(members):
    return Page(members["documentation/index.html"].decode())


def terminals(model, data):
    schema = etree.XMLSchema(etree.parse(Path(fmpy.__file__).parent / "schema" / "fmi3" / "fmi3TerminalsAndIcons.xsd"))
    root = etree.fromstring(data["terminalsAndIcons/terminalsAndIcons.xml"])
    schema.assertValid(root)
    pictures = [t.find("TerminalGraphicalRepresentation").get("iconBaseName") for t in root.iter("Terminal")]
    assert {f"terminalsAndIcons/{picture}.png" for picture in pictures} <= set(data)  # a model may have none
    members = {t.get("name"): t.iter("TerminalMemberVariable") for t in root.iter("Terminal")}
    return {name: [m.get("variableName") for m in variables] for name, variables in members.items()}

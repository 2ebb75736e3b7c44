"""Icons and terminals of an FMU: how tools draw its block and which scalars belong together."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from xml.etree import ElementTree as ET

from fmu_export.errors import needs
from fmu_export.modelling.model import Model
from fmu_export.modelling.variables import Layout
from fmu_export.package.description_common import to_bytes

with needs("export"):
    from PIL import Image, ImageDraw, ImageFont

_FACE, _EDGE, _INK = "#eaf1f8", "#1f4e79", "#1f4e79"
#: Extent of the block; terminals stand on its left and right edge.
_HALF = 100
#: Icons are drawn so many times larger, and made smaller, so that their edges are smooth.
_LARGER = 8


def model_icon(model: Model) -> bytes:
    """A block with the capitals of the model's name, PNG, 64 x 64."""
    letters = "".join(c for c in model.name if c.isupper())[:3] or model.name[:1].upper()

    def draw(block: ImageDraw.ImageDraw, n: int) -> None:
        edge = 0.045 * n, 0.045 * n, 0.955 * n, 0.955 * n
        block.rounded_rectangle(edge, radius=0.13 * n, fill=_FACE, outline=_EDGE, width=round(0.028 * n))
        font = ImageFont.load_default((0.42 if len(letters) < 3 else 0.28) * n)
        bold = round(0.012 * n)
        left, top, right, bottom = block.textbbox((0, 0), letters, font=font, stroke_width=bold)
        place = 0.5 * (n - left - right), 0.5 * (n - top - bottom)
        block.text(place, letters, _INK, font=font, stroke_width=bold)

    return _png(draw, pixels=64)


def terminal_icons(model: Model, *, with_terminals: bool = True) -> dict[str, bytes]:
    """Members of `terminalsAndIcons/` (FMI 3.0, section 2.4.9): description, block icon, icons of the terminals.

    Each array among the inputs and outputs is a terminal, unless it is one variable, which needs none. Its elements
    match by order ("sequence"), so vectors of one length can be connected whatever their names are.
    """

    def triangle(face: str) -> Callable[[ImageDraw.ImageDraw, int], None]:
        def draw(port: ImageDraw.ImageDraw, n: int) -> None:
            corners = [(0.05 * n, 0.05 * n), (0.05 * n, 0.95 * n), (0.95 * n, 0.5 * n)]
            port.polygon(corners, fill=face, outline=_EDGE, width=round(0.07 * n))

        return draw

    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    graphics = ET.SubElement(root, "GraphicalRepresentation")
    extent = {"x1": str(-_HALF), "y1": str(-_HALF), "x2": str(_HALF), "y2": str(_HALF)}
    ET.SubElement(graphics, "CoordinateSystem", extent, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(graphics, "Icon", extent)
    terminals = ET.Element("Terminals")
    if with_terminals:
        _terminals(terminals, model.inputs, "input", -_HALF - 10)
        _terminals(terminals, model.outputs, "output", _HALF + 10)
    if len(terminals):
        root.append(terminals)
    return {
        "terminalsAndIcons/terminalsAndIcons.xml": to_bytes(root),
        "terminalsAndIcons/icon.png": model_icon(model),
        "terminalsAndIcons/input.png": _png(triangle(_EDGE), pixels=16),
        "terminalsAndIcons/output.png": _png(triangle("white"), pixels=16),
    }


def _terminals(parent: ET.Element, layout: Layout, icon: str, x: int) -> None:
    vectors = [v for v in layout.variables if v.size]
    for i, v in enumerate(vectors):
        terminal = ET.SubElement(parent, "Terminal", name=v.name, matchingRule="sequence", description=v.description)
        for name in v.names:
            ET.SubElement(terminal, "TerminalMemberVariable", variableName=name, variableKind="signal")
        y = round(_HALF * (1 - 2 * (i + 1) / (len(vectors) + 1)))
        corners = {"x1": x - 10, "y1": y - 10, "x2": x + 10, "y2": y + 10}
        place = {name: str(value) for name, value in corners.items()}
        ET.SubElement(terminal, "TerminalGraphicalRepresentation", place, iconBaseName=icon)


def _png(draw: Callable[[ImageDraw.ImageDraw, int], None], pixels: int) -> bytes:
    n = _LARGER * pixels
    image = Image.new("RGBA", (n, n), _EDGE + "00")  # so that edges fade in their own colour
    draw(ImageDraw.Draw(image), n)
    stream = BytesIO()
    image.reduce(_LARGER).save(stream, "PNG")
    return stream.getvalue()

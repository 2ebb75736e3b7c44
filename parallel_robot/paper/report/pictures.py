"""Figures of the report: deflated, and drawn when they come into view."""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from html import escape

from parallel_robot.paper.report.prose import prose

_SVG, _PNG = "image/svg+xml", "image/png"


@dataclass(frozen=True)
class Picture:
    """A figure with its texts.

    Attributes
    ----------
    id : str
    title, caption, alt : str
    content : bytes
        An SVG or a PNG.
    """

    id: str
    title: str
    caption: str
    alt: str
    content: bytes

    @property
    def kind(self) -> str:
        """Its media type."""
        return _PNG if self.content.startswith(b"\x89PNG") else _SVG

    @property
    def deflated(self) -> bytes:
        """What goes into the page, under the id with "-data" behind it."""
        return zlib.compress(self.content, 9)

    def html(self, name: str, number: str = "") -> str:
        """The figure; `name` says what its button enlarges, `number` stands before the title."""
        width, height = self._size()
        # as an image and not inline: the names inside two SVGs of matplotlib clash
        return f"""<figure id="{escape(self.id, quote=True)}">
<button type="button" class="enlarge" aria-label="Enlarge {escape(name, quote=True)}">
<img data-block="{escape(self.id, quote=True)}-data" data-kind="{self.kind}" width="{width:g}" height="{height:g}" alt="{escape(self.alt, quote=True)}"></button>
<figcaption><b>{number}{prose(self.title)}.</b> {prose(self.caption)}</figcaption>
</figure>
"""  # noqa: E501

    def _size(self) -> tuple[float, float]:
        """Width and height, which keep its place before it is drawn."""
        if self.kind == _PNG:
            return int.from_bytes(self.content[16:20], "big"), int.from_bytes(self.content[20:24], "big")
        box = re.search(rb'viewBox="[-\d.]+ [-\d.]+ ([\d.]+) ([\d.]+)"', self.content[:4000])
        return (float(box[1]), float(box[2])) if box else (16.0, 9.0)

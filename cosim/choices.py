"""What the command line lets choose from; apart from what does it, which takes a while to import."""

from __future__ import annotations

#: Formats of results, by the endings of their files.
FORMATS = ("csv", "parquet", "npz", "mat")

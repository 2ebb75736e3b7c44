"""Pages in the cells of notebooks: an HTML page in a frame that keeps its scripts to itself."""

from __future__ import annotations

from html import escape

#: Bytes that a cell may have: notebooks are files that people mail and keep under version control.
MOST_BYTES = 1_000_000


def frame(page: str, title: str, height: int = 640) -> str:
    """A page as an element that notebooks, and what is exported from them, draw where it stands.

    The page runs its scripts, of which its policy names all, and reaches neither the notebook nor the network.

    Parameters
    ----------
    page : str
        HTML of a whole page.
    title : str
        As text, for those who do not see it.
    height : int
        In pixels; the reader can change it.
    """
    text = page.replace("&", "&amp;").replace('"', "&quot;")
    return (
        f'<iframe title="{escape(title, quote=True)}" sandbox="allow-scripts" width="100%" height="{height}" '
        f'style="border: 0; resize: vertical" srcdoc="{text}"></iframe>'
    )

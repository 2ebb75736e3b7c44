"""What is wrong with a file of others: that it can't be run, or only that it is not as the standard has it."""

from __future__ import annotations

from dataclasses import dataclass, field

#: Of one text of a file so many characters are shown.
_MOST_SHOWN = 60

#: So many findings of one kind are named.
_MOST_OF_A_KIND = 3


@dataclass
class FileFindings:
    """Findings about one file, each a text that is to follow the name of the file.

    Attributes
    ----------
    wrong : list of str
        Why it can't be run, or would give other numbers than it says.
    unclean : list of str
        What is not as the standard has it, and does no harm to a run.
    """

    wrong: list[str] = field(default_factory=list)
    unclean: list[str] = field(default_factory=list)

    def add(self, *, wrong: str = "", unclean: str = "") -> None:
        """Add a finding once; of a kind, which begins alike up to its first quote, the first few."""
        for text, found in ((wrong, self.wrong), (unclean, self.unclean)):
            kind = text.partition("'")[0]
            if text and text not in found and sum(other.startswith(kind) for other in found) < _MOST_OF_A_KIND:
                found.append(text)


def quoted(text: object) -> str:
    """A text of a file for a message: in quotes, without control characters, and not longer than a line can take."""
    shown = str(text)
    cut = shown if len(shown) <= _MOST_SHOWN else f"{shown[:_MOST_SHOWN]}..."
    return repr(cut)

"""What is wrong with a file of others: that it can't be run, or only that it is not as the standard has it."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field

#: Of one text of a file so many characters are shown.
_MOST_SHOWN = 60

#: So many findings of one kind are kept.
_MOST_OF_A_KIND = 3

#: What differs between findings of one kind: texts of the file in quotes, and numbers.
_PARTICULAR = re.compile(r"'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\"|\d+")


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
    _kinds: Counter[str] = field(default_factory=Counter)

    def add(self, *, wrong: str = "", unclean: str = "") -> None:
        """Add a finding; of one kind the first few are kept, for a file may have as many as it has variables."""
        for text, found in ((wrong, self.wrong), (unclean, self.unclean)):
            if text:
                kind = _PARTICULAR.sub("", text)
                self._kinds[kind] += 1
                if self._kinds[kind] <= _MOST_OF_A_KIND:
                    found.append(text)


def quoted(text: object) -> str:
    """A text of a file for a message: in quotes, without control characters, and not longer than a line can take."""
    shown = str(text)
    cut = shown if len(shown) <= _MOST_SHOWN else f"{shown[:_MOST_SHOWN]}..."
    return repr(cut)

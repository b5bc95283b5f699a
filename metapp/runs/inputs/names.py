"""Names of tasks that differ: files of one run may hold tasks of one name."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

from metapp.runs.reporter import say


class Names:
    """Names by the places that have them; where a name repeats, later ones are numbered, and it is said."""

    def __init__(self) -> None:
        self._places: dict[str, str] = {}

    def add(self, places: Mapping[str, str]) -> None:
        """Take note of the places of names that were given out by another run."""
        self._places |= places

    def unique(self, name: str, place: str) -> str:
        """The name, numbered where another place has it; the same for the same place."""
        numbers, numbered = itertools.count(2), name
        while self._places.setdefault(numbered, place) != place:
            numbered = f"{name}-{next(numbers)}"
        if numbered != name:
            say(f"warning: a second {name} is called {numbered}")
        return numbered

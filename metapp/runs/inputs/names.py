"""Names of tasks that differ: inputs of one run may have one name."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path

from metapp.runs.reporter import say


def marks_of(stems: Mapping[str, str]) -> dict[str, str]:
    """What names begin with, by path, where stems are the same: the nearest folders that differ, else the suffixes."""
    groups: dict[str, list[Path]] = {}
    for place, stem in stems.items():
        groups.setdefault(stem, []).append(Path(place))
    marks: dict[str, str] = {}
    for places in groups.values():
        own = [""] * len(places)
        folders = itertools.zip_longest(*(reversed(place.parts[1:-1]) for place in places), fillvalue="")
        for parts in (*folders, [place.suffix[1:] for place in places]):
            if len(set(own)) < len(own) and len(set(parts)) > 1:
                own = ["-".join(filter(None, pair)) for pair in zip(parts, own, strict=True)]
        marks |= zip(map(str, places), own, strict=True)
    return marks


def numbered(name: str, place: str, places: dict[str, str]) -> str:
    """A name, numbered where another of the `places` of names has it; they take note of it."""
    numbers, own = itertools.count(2), name
    while places.setdefault(own, place) != place:
        own = f"{name}-{next(numbers)}"
    if own != name:
        say(f"warning: a second {name} is called {own}")
    return own

"""Lines of a text of light directions (`.lp`), as programs of RTI, spreadsheets and people write them.

The first line is the number of photographs; each further line holds a photograph's name and the direction to its light.
Names may have blanks, quotes and folders; numbers may have decimal commas.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

from typing_extensions import override

from metapp.storage.files import read_text

_EXPECTED = "expected the number of photos, then 'name x y z' for each; correct it."
_COMMENT_MARKS = ("#", "//", ";", "%")  # at the beginning of a line that is no photograph's
_SEPARATORS = (";", "\t+", r",?\s+", r"[;,\s]+")  # of names and numbers; later ones where earlier ones part no numbers
_NUMBER = re.compile(r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)(e[+-]?[0-9]+)?", re.IGNORECASE)
_COUNT = re.compile(r"0*([1-9][0-9]*)(?:[\s;,]\D*)?")  # a number, perhaps with a word or a comment behind it
_END_OF_FILE_NAME = re.compile(r"""\.[a-z][a-z0-9]{1,4}["']?$""", re.IGNORECASE)
_TITLES = re.compile(r"x\W+\w{0,9}y\W+\w{0,9}z\b", re.IGNORECASE)  # of columns, such as "name lx ly lz"
_LENGTH_TOLERANCE = 0.02  # of unit vectors in texts of few digits
_SHORTEST, _LONGEST = 1e-3, 1e6  # lengths of directions; positions of lights count as directions
_NAMED_IN_LINES = 3  # things that a message names; it counts the others


class LightLine(NamedTuple):
    """A photograph's line in a text of light directions.

    Attributes:
        number: the number of the line in the text, from 1.
        name: the photograph's name as the text states it, without folders; "" if the line has numbers alone.
        direction: x, y and z towards the light, of any length.
    """

    number: int
    name: str
    direction: tuple[float, float, float]

    @override
    def __str__(self) -> str:
        return f"line {self.number} ({self.name[:60]!r})"


def list_first(things: Sequence[object]) -> str:
    """Return the first things of a list, and the number of the others.

    >>> list_first(["a", "b", "c", "d"])
    'a, b, c and 1 more'
    """
    more = f" and {len(things) - _NAMED_IN_LINES} more" if len(things) > _NAMED_IN_LINES else ""
    return ", ".join(map(str, things[:_NAMED_IN_LINES])) + more


def read_light_lines(path: Path) -> tuple[list[LightLine], list[str]]:
    """Read the lines of a text of light directions.

    The line with the number of photographs may be missing; if it is there, it must be true. Blank lines, comments and
    titles of columns are left out. Of more than three numbers the three that are a unit vector in all lines are the
    direction.

    Returns:
        The lines, and messages for the user of what was taken otherwise than expected.

    Raises:
        ValueError: the text cannot be read, or a line is malformed.
    """
    try:
        rows = [(number, line.strip()) for number, line in enumerate(read_text(path).splitlines(), 1)]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected a line for each photo; write it again.") from error
    rows = [(number, line) for number, line in rows if line and not line.startswith(_COMMENT_MARKS)]
    rows = [row for row in rows if not _TITLES.search(row[1]) or _split_line(row[1])[1]]
    if not rows:
        raise ValueError(f"{path}: no line, {_EXPECTED}")
    (number, count_line), *photo_rows = rows
    if _split_line(count_line)[1]:  # a photograph's
        photo_rows = rows
    # compared as texts, since int() refuses some digits, and numbers of thousands of digits
    elif not (count := _COUNT.fullmatch(count_line)) or count[1] != str(len(photo_rows)):
        found = f"line {number} is {count_line[:20]!r} above {len(photo_rows)} lines"
        raise ValueError(f"{path}: {found}, {_EXPECTED}")
    parts = [(number, line, *_split_line(line)) for number, line in photo_rows]
    for number, line, _, numbers in parts:
        if not numbers:
            found = f"line {number} is {line[:60]!r}"
            raise ValueError(f"{path}: {found}, expected a name and a direction x y z; correct it.")
    first, note = _find_direction_column(path, {number: numbers for number, *_, numbers in parts})
    lines = []
    for number, line, name, numbers in parts:
        x, y, z = numbers[first : first + 3]
        if not _SHORTEST < math.hypot(x, y, z) < _LONGEST:
            found = f"line {number} is {line[:60]!r}"
            raise ValueError(f"{path}: {found}, expected a name and a direction x y z; correct it.")
        lines.append(LightLine(number, PureWindowsPath(name.strip(" \"'")).name, (x, y, z)))  # either kind of slash
    return lines, [note] if note else []


def _split_line(line: str) -> tuple[str, list[float]]:
    """Split a line into the name of a photograph and three numbers or more; without them there are no numbers.

    Numbers right behind an ending such as ".jpg" are all returned, whatever follows them. Where no name has an ending,
    they are the last three words of the line, since names may hold numbers.
    """
    line = line.strip(" \t;,")
    for separator in _SEPARATORS:
        words = re.split(f"({separator})", line)  # every other one is a separator
        numbers = [_to_number(word) for word in words[::2]]
        count = len(numbers)
        for first in range(1, count - 2):
            if None not in numbers[first : first + 3] and _END_OF_FILE_NAME.search(words[2 * first - 2].strip()):
                behind = list(itertools.takewhile(lambda number: number is not None, numbers[first:]))
                return "".join(words[: 2 * first - 1]), [number for number in behind if number is not None]
        last = [number for number in numbers[-3:] if number is not None]
        if len(last) == 3:
            return "".join(words[: max(0, 2 * count - 7)]), last
    return line, []


def _to_number(word: str) -> float | None:
    """Return the number of a word, with a decimal point or comma; None if it is none."""
    word = word.strip()
    return float(word.replace(",", ".")) if _NUMBER.fullmatch(word) else None


def _find_direction_column(path: Path, rows: dict[int, list[float]]) -> tuple[int, str]:
    """Return the index of the first number of the directions, and a message if lines have other numbers, too.

    Args:
        path: the text.
        rows: the numbers behind the name in each line, by the number of the line.

    Raises:
        ValueError: the lines do not tell which three numbers are the direction.
    """
    ((columns, _),) = Counter(map(len, rows.values())).most_common(1)
    if odd := [number for number, row in rows.items() if len(row) != columns]:
        found = f"other than {columns} numbers behind the name in {len(odd)} of {len(rows)} lines: {list_first(odd)}"
        raise ValueError(f"{path}: {found}, expected as many in all lines; correct them.")
    if columns == 3:
        return 0, ""
    firsts = [
        first
        for first in range(columns - 2)
        if all(abs(math.hypot(*row[first : first + 3]) - 1) < _LENGTH_TOLERANCE for row in rows.values())
    ]
    if len(firsts) != 1:
        found = f"{columns} numbers behind names, of which {len(firsts)} triples have length 1 in all lines"
        raise ValueError(f"{path}: {found}, expected three numbers x y z; remove the others.")
    found = f"{columns} numbers behind each name, expected x y z"
    return firsts[0], f"{path}: {found}; taken: numbers {firsts[0] + 1} to {firsts[0] + 3}, which have length 1."

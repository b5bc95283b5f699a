"""Mesh files of scenes, checked before Mitsuba reads them: it trusts the indices of PLY and .serialized files.

An index past the vertices reads memory that is not the mesh's, and ends the process; a count past the file's end asks
for gigabytes. What is checked here is read as Mitsuba 3.9 reads it, in blocks, so that memory stays flat; what it would
refuse in clear words itself, such as polygons in PLY files, is left to it where it does no harm. OBJ files are: Mitsuba
checks each of their indices.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

ROWS = 2**16  # of a table, read at a time
BLOCK = 2**20  # bytes of text, or of a compressed stream, read at a time
_HEADER = 2**16  # bytes of a PLY header
MOST = 2**31 - 1  # vertices, or triangles

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "long": "i8", "ulong": "u8",
    "half": "f2", "float16": "f2", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_index", "vertex_indices")
_CORNERS = ("i0", "i1", "i2")  # names of the columns of a list
_TRIANGLES = "expected triangles"


class _Element(NamedTuple):
    """A table of a PLY file: its rows, and the names and types of its columns; a list is a count and three columns."""

    name: str
    rows: int
    columns: dict[str, str]


def check_ply(path: Path, *, faces: bool = True) -> None:
    """Refuse a PLY file that Mitsuba would read past its end, or whose triangles name no vertices of it.

    Args:
        path: of the file.
        faces: whether it must hold triangles; those of ellipsoids hold none.

    Raises:
        ValueError: no such PLY file.
    """
    with path.open("rb") as file:
        order, elements = _ply_header(file)
        tables = {element.name: element for element in elements if element.name in ("vertex", "face")}
        if len(tables) != sum(element.name in tables for element in elements):
            raise ValueError("two tables of vertices or faces, expected one of each.")
        vertices = tables["vertex"].rows if "vertex" in tables else 0
        if not vertices or (faces and not ("face" in tables and tables["face"].rows)):
            raise ValueError("no vertices or no faces, expected a mesh; leave the shape out.")
        columns = {name: element.columns for name, element in tables.items()}
        if not {"x", "y", "z"} <= set(columns["vertex"]):
            raise ValueError("vertices without x, y or z, expected positions.")
        if faces and not any(f"{name}.count" in columns["face"] for name in _INDICES):
            raise ValueError("faces without vertex_indices, expected a list of three for each.")
        rows = _text_rows(file, elements) if order == "" else _binary_rows(file, elements, order)
        for name, table in rows:
            if name == "vertex":
                check_finite(np.stack([table[axis] for axis in "xyz"]).astype(np.float64))
            elif name == "face" and faces:
                count = next(table[f"{key}.count"] for key in _INDICES if f"{key}.count" in columns["face"])
                if not (count == 3).all():
                    raise ValueError(f"a face of {_first(count[count != 3])} vertices, {_TRIANGLES}; triangulate it.")
                check_indices(np.stack([table[corner] for corner in _CORNERS]), vertices)


def _ply_header(file: IO[bytes]) -> tuple[str, list[_Element]]:
    """The byte order, "" for text, and the tables; the file is left at their beginning."""
    lines: list[list[str]] = []
    while not lines or lines[-1] != ["end_header"]:
        line = file.readline(_HEADER)
        if not line.endswith(b"\n") or file.tell() > _HEADER or b"\r" in line.rstrip(b"\r\n"):
            raise ValueError(f"no end_header in the first {_HEADER:,} bytes, expected a PLY file.")
        words = [word.decode("ascii", "replace") for word in line.split()]
        if words[:1] not in ([], ["comment"]):
            lines.append(words)
    match lines[:2]:
        case [["ply"], ["format", order, "1.0"]] if order in _ORDERS:
            pass
        case first:
            shown = " ".join(word for line in first for word in line)
            raise ValueError(f"begins with {shown[:60]!r}, expected a PLY file of format 1.0.")
    elements: list[_Element] = []
    for words in lines[2:-1]:
        match words:
            case ["element", name, count] if re.fullmatch(r"\d{1,10}", count) and int(count) <= MOST:
                elements.append(_Element(name, int(count), {}))
            case ["property", "list", kind, index, name] if elements and {kind, index} <= _TYPES.keys():
                _add_list(elements[-1], _TYPES[kind], _TYPES[index], name)
            case ["property", kind, name] if elements and kind in _TYPES and _is_new(name, elements[-1]):
                elements[-1].columns[name] = _TYPES[kind]
            case _:
                raise ValueError(f"a line {' '.join(words)[:60]!r} in its header, expected a table or a column of one.")
    return _ORDERS[order], elements


def _is_new(name: str, element: _Element) -> bool:
    """Whether a column has a name that neither another has nor one of a list."""
    return name not in element.columns and name not in _CORNERS and not name.endswith(".count")


def _add_list(element: _Element, kind: str, index: str, name: str) -> None:
    """Three columns and their number, as Mitsuba takes every list."""
    whole = kind[0] in "iu" and index[0] in "iu" and index[1] != "8"
    if element.name != "vertex" and whole and "i0" not in element.columns:
        element.columns.update({f"{name}.count": kind, **dict.fromkeys(_CORNERS, index)})
        return
    raise ValueError(f"a list {name[:40]!r}, expected one a face, of integers of 32 bits or fewer; leave it out.")


def _binary_rows(file: IO[bytes], elements: list[_Element], order: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """Blocks of the tables, with the names of these."""
    kinds = [np.dtype([(name, order + kind) for name, kind in element.columns.items()]) for element in elements]
    begin = file.tell()
    size, needed = (
        file.seek(0, 2) - begin,
        sum(e.rows * kind.itemsize for e, kind in zip(elements, kinds, strict=True)),
    )
    if size != needed:
        raise ValueError(
            f"{size:,} bytes after the header, expected {needed:,}; it is incomplete, or no {_TRIANGLES[9:]}."
        )
    file.seek(begin)
    for element, kind in zip(elements, kinds, strict=True):
        for first in range(0, element.rows if kind.itemsize else 0, ROWS):
            count = min(ROWS, element.rows - first)
            yield element.name, np.frombuffer(file.read(count * kind.itemsize), kind, count)


_PLAIN = b"0123456789+-.eE \t\r\n"  # of numbers in text: all else, two parsers may read in two ways


def _text_rows(file: IO[bytes], elements: list[_Element]) -> Iterator[tuple[str, dict[str, NDArray[Any]]]]:
    """As `_binary_rows`, of a file whose tables are text."""
    blocks = _words(file)
    waiting: list[bytes] = []
    for element in elements:
        width, left = len(element.columns), element.rows
        while left and width:
            while len(waiting) < width and (block := next(blocks, None)) is not None:
                waiting += block
            rows = min(left, len(waiting) // width)
            if not rows:
                raise ValueError(f"{left:,} rows of {element.name[:40]!r} are missing, expected a whole file.")
            part, waiting, left = waiting[: rows * width], waiting[rows * width :], left - rows
            yield (
                element.name,
                {
                    name: _numbers(part[column::width], kind)
                    for column, (name, kind) in enumerate(element.columns.items())
                },
            )
    if waiting or next(blocks, []):
        raise ValueError(f"more numbers than the header tells of, {_TRIANGLES}; triangulate it.")


def _words(file: IO[bytes]) -> Iterator[list[bytes]]:
    rest = b""
    while block := file.read(BLOCK):
        if block.translate(None, _PLAIN):
            raise ValueError("more than numbers after the header, expected these alone.")
        text = rest + block
        end = max(text.rfind(blank) for blank in (b" ", b"\t", b"\r", b"\n")) + 1
        rest = text[end:]
        if len(rest) > 256:
            raise ValueError("a number of more than 256 digits, expected shorter ones.")
        yield text[:end].split()
    if rest:
        yield [rest]


def _numbers(words: list[bytes], kind: str) -> NDArray[np.float64]:
    text = b" ".join(words)
    if kind[0] in "iu" and text.translate(None, b"0123456789+- "):
        raise ValueError("a fraction in a column of integers, expected integers.")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # it says so where a word is no number
        try:
            numbers: NDArray[np.float64] = np.fromstring(text, dtype=np.float64, sep=" ")
        except (DeprecationWarning, ValueError):
            numbers = np.empty(0)
    if len(numbers) != len(words):
        raise ValueError("words that are no numbers after the header, expected numbers alone.")
    return numbers


def check_finite(positions: NDArray[Any]) -> None:
    """Refuse coordinates of vertices, of any shape, that are NaN or infinite."""
    with np.errstate(over="ignore"):
        finite = np.isfinite(positions.astype(np.float32))  # as which Mitsuba keeps them
    if not finite.all():
        raise ValueError(f"a coordinate {_first(positions[~finite])} of a vertex, expected finite ones.")


def check_indices(indices: NDArray[Any], vertices: int) -> None:
    """Refuse corners of triangles, of any shape, that are none of so many vertices."""
    past = (indices < 0) | (indices >= vertices)
    if past.any():
        index = int(_first(indices[past]))
        raise ValueError(f"a face at vertex {index:,}, expected 0 to {vertices - 1:,}; export it again.")


def _first(values: NDArray[Any]) -> Any:
    return values.ravel()[0].item()


def check_obj(path: Path) -> None:
    """Refuse an OBJ file without faces; Mitsuba checks the indices of all others.

    Raises:
        ValueError: it has none.
    """
    last = b"\n"
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            if re.search(rb"\n[ \t\r]*f[ \t]", last + block):
                return
            last = b"\n" if block.endswith(b"\n") else block[-64:]
    raise ValueError("no faces, expected a mesh; leave the shape out.")

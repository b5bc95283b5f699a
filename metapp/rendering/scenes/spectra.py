"""Checks of spectra that a scene states: values over wavelengths, which Mitsuba takes whatever they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from metapp.storage.files import open_regular

MAX_SPECTRUM_BYTES = 2**20  # of a file of a spectrum
VISIBLE_NM = (360.0, 830.0)  # wavelengths of the CIE's observer, by which Mitsuba computes colours
_MOST_FLOAT = float(np.finfo(np.float32).max)  # Mitsuba holds wavelengths and values in single precision


def check_spectrum(rows: Iterable[tuple[str, Sequence[float]]]) -> None:
    """Refuse a spectrum by which no colour can be computed.

    Args:
        rows: for each row its place in messages, such as "line 3", its wavelength in nm and its value.

    Raises:
        ValueError: fewer than two rows, wavelengths that do not rise or of which none is visible, numbers that are
            negative or too large for single precision.
    """
    first, previous, count = 0.0, 0.0, 0
    for place, (wavelength, value) in rows:
        if not 0 < wavelength <= _MOST_FLOAT:
            raise ValueError(f"{place}: a wavelength of {wavelength:g} nm, expected a positive one; correct it.")
        if wavelength <= previous:
            raise ValueError(
                f"{place}: a wavelength of {wavelength:g} nm after {previous:g}, expected rising ones; sort the rows."
            )
        if not 0 <= value <= _MOST_FLOAT:
            raise ValueError(f"{place}: a value of {value:g}, expected a finite one of 0 or more; correct it.")
        first, previous, count = first or wavelength, wavelength, count + 1
    if count < 2:
        raise ValueError(
            f"a spectrum of {count} rows, expected two or more, of a wavelength and a value; state both ends of it."
        )
    if previous <= VISIBLE_NM[0] or first >= VISIBLE_NM[1]:
        raise ValueError(
            f"wavelengths of {first:g} to {previous:g} nm, which are black, expected some from {VISIBLE_NM[0]:g} to "
            f"{VISIBLE_NM[1]:g}; state them in nanometres."
        )


def check_spectrum_file(path: Path) -> None:
    """Refuse a file of a spectrum unless its lines are comments (#) or a wavelength in nm and a value, with a blank.

    Raises:
        ValueError: the file is no text or too long; see also :func:`check_spectrum`.
    """
    with open_regular(path) as file:
        content = file.read(MAX_SPECTRUM_BYTES + 1)
    if len(content) > MAX_SPECTRUM_BYTES:
        raise ValueError(f"more than {MAX_SPECTRUM_BYTES:,} bytes, expected fewer; thin its rows out.")
    try:
        text = content.decode()  # with a byte order mark, which Mitsuba takes for a part of the first row
    except UnicodeDecodeError:
        raise ValueError("not text, expected lines of a wavelength and a value; export it again.") from None
    lines = ((f"line {number}", line) for number, line in enumerate(text.split("\n"), 1))
    check_spectrum((place, _read_row(place, line)) for place, line in lines if line.strip() and line[0] != "#")


def check_spectrum_plugin(kind: str, given: Mapping[str, object]) -> None:
    """Refuse an object of type `regular` or `irregular` with a spectrum that :func:`check_spectrum` refuses.

    Args:
        kind: name of the plugin; others are not checked.
        given: its parameters.
    """
    if kind not in ("regular", "irregular") or "filename" in given:
        return
    values = _read_numbers(kind, "values", given)
    if kind == "irregular":
        wavelengths = _read_numbers(kind, "wavelengths", given)
    else:
        low, high = (given.get(f"wavelength_{end}") for end in ("min", "max"))
        if not (isinstance(low, int | float) and isinstance(high, int | float)):
            raise ValueError("a 'regular' without wavelength_min and wavelength_max, expected both; add them.")
        step = (high - low) / max(1, len(values) - 1)
        wavelengths = [low + step * index for index in range(len(values))]
    if len(wavelengths) != len(values):
        raise ValueError(
            f"an '{kind}' of {len(wavelengths)} wavelengths and {len(values)} values, expected as many; correct it."
        )
    check_spectrum((f"pair {index}", pair) for index, pair in enumerate(zip(wavelengths, values, strict=True), 1))


def _read_row(place: str, line: str) -> list[float]:
    """Return the two numbers of a line."""
    words = line.split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) != 2 or "_" in line or not line.isascii():
        raise ValueError(f"{place}: {line[:40]!a}, expected a wavelength and a value with a blank between; correct it.")
    return numbers


def _read_numbers(kind: str, name: str, given: Mapping[str, object]) -> list[float]:
    """Return the numbers of a parameter's text, divided by commas or blanks."""
    text = given.get(name)
    try:
        return [float(word) for word in str(text).replace(",", " ").split()]
    except ValueError:
        raise ValueError(f"an '{kind}' with '{name}' of {str(text)[:40]!r}, expected numbers; correct it.") from None

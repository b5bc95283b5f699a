"""Scenes of Mitsuba 3 in memory: dictionaries, as `mi.load_dict` takes them, and the text of XML documents; as files.

Nothing in them is trusted more than in a file: `data_tools.readers.mitsuba_scenes` checks the same. Files that they
name lie in the current folder, or in folders of `scene_root`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from metapp.rendering.scenes.rules import DEPTH

_NUMBERS = ("numpy", "mitsuba", "drjit", "torch")  # whose arrays of numbers a scene may hold
_SHAPES = ((), (3,), (3, 3), (4, 4))


def to_file(source: object, name: str, folder: Path, observe: str) -> Path:
    """Write a scene as a JSON or XML file.

    Args:
        source: a dictionary of type "scene", of numbers, texts, transforms and dictionaries; or the text of an XML
            document.
        name: of the file.
        folder: where to.
        observe: what fits see; of no use here.

    Raises:
        ValueError: neither; it holds something that JSON does not, such as a material that Mitsuba has loaded.
    """
    if isinstance(source, str):
        path, text = folder / f"{name}.xml", source
    elif isinstance(source, Mapping):
        path, text = folder / f"{name}.json", json.dumps(_plain(name, "scene", source))
    else:
        raise ValueError(
            f"{name}: {type(source).__name__}, expected a path, a scene as Mitsuba's load_dict takes it, or XML text."
        )
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    return path


def _plain(name: str, key: str, value: Any, depth: int = 0) -> Any:
    """A value of a scene as JSON holds it."""
    if depth > DEPTH:
        raise ValueError(f"{name}: objects within each other, more than {DEPTH} deep, expected fewer.")
    if isinstance(value, Mapping):
        return {str(own): _plain(name, str(own), part, depth + 1) for own, part in value.items()}
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, list | tuple):
        return [_plain(name, key, part, depth + 1) for part in value]
    numbers = _numbers(value)
    if numbers is None:
        raise ValueError(
            f"{name}: {type(value).__name__} as {key[:40]!r}, expected numbers, text, a transform or a dictionary; "
            "give what it was made of, or the name of a file."
        )
    return numbers.tolist()


def _numbers(value: Any) -> np.ndarray | None:
    """Numbers of numpy, Mitsuba or Dr.Jit, a transform as its matrix; None of all else."""
    if type(value).__module__.partition(".")[0] not in _NUMBERS:
        return None
    try:
        numbers = np.array(value)
        numbers = np.array(value.matrix) if numbers.dtype == object else numbers
    except Exception:  # whatever an object of another library raises
        return None
    if numbers.shape[-1:] == (1,):  # of a variant that works on arrays
        numbers = numbers[..., 0]
    return numbers if numbers.dtype.kind in "uifb" and numbers.shape in _SHAPES else None

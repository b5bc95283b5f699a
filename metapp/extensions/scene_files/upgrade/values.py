"""Reading and writing parameters of elements of a scene in XML, as upgrades need them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from xml.etree.ElementTree import Element

import torch

from metapp.appearance.colour import srgb_to_linear
from metapp.extensions.scene_files.xml import SceneElement
from metapp.rendering.scenes.plugins import number_of, snake_case


def made(tag: str, **attributes: str) -> SceneElement:
    """An element that no document holds."""
    return SceneElement(tag, attributes)


def name_of(element: Element) -> str:
    """The name of a parameter as Mitsuba 3 has it, which renames those of scenes of version 0.6: toWorld, to_world."""
    return snake_case(element.get("name", ""))


def child(element: SceneElement, name: str) -> SceneElement | None:
    """The first parameter of this name."""
    return next((part for part in element if name_of(part) == name), None)


def numbers(text: str) -> tuple[float, ...]:
    """Finite numbers between blanks or commas; none where there is anything else."""
    values = [number_of(part) for part in text.replace(",", " ").split()]
    finite = tuple(value for value in values if value is not None and math.isfinite(value))
    return finite if len(finite) == len(values) else ()


def shown(values: Iterable[float]) -> str:
    """Numbers as a document has them."""
    return ", ".join(f"{value:.7g}" for value in values)


def linear_rgb(text: str) -> tuple[float, ...]:
    """Linear RGB of sRGB: '#rrggbb', or one or three numbers in [0, 1]; nothing where it is neither."""
    if re.fullmatch("#[0-9a-fA-F]{6}", text):
        values: tuple[float, ...] = tuple(int(text[i : i + 2], 16) / 255 for i in (1, 3, 5))
    else:
        values = numbers(text)
    values = values * 3 if len(values) == 1 else values
    return tuple(srgb_to_linear(torch.tensor(values, dtype=torch.float64)).tolist()) if len(values) == 3 else ()

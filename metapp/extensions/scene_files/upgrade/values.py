"""Reading and writing parameters of elements of a scene in XML, as upgrades need them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import numpy as np
import torch

from metapp.appearance.colour import srgb_to_linear
from metapp.extensions.scene_files.xml import SceneElement
from metapp.rendering.scenes.plugins import number_of

Colour = tuple[float, float, float]

_PLANCK, _LIGHT, _BOLTZMANN = 6.62606957e-34, 299_792_458.0, 1.3806488e-23
_WAVELENGTHS = range(360, 831, 10)  # nm, those that Mitsuba integrates over


def snake_case(name: str) -> str:
    """A name as Mitsuba's own upgrade changes it: toWorld to to_world, intIOR to int_ior."""
    return re.sub("(?<=[a-z])[A-Z]+", lambda found: f"_{found[0].lower()}", name)


def made(tag: str, *inside: SceneElement, **attributes: str) -> SceneElement:
    """An element that no document holds."""
    element = SceneElement(tag, attributes)
    element.extend(inside)
    return element


def child(element: SceneElement, name: str) -> SceneElement | None:
    """The first parameter of this name."""
    return next((part for part in element if part.get("name") == name), None)


def taken(element: SceneElement, name: str) -> SceneElement | None:
    """The first parameter of this name, which the element has no longer."""
    found = child(element, name)
    if found is not None:
        element.remove(found)
    return found


def numbers(text: str) -> tuple[float, ...] | None:
    """Finite numbers between blanks or commas; None where there is anything else."""
    values = [_finite(part) for part in text.replace(",", " ").split()]
    plain = tuple(value for value in values if value is not None)
    return plain if plain and len(plain) == len(values) else None


def number(element: SceneElement | None, default: float) -> float | None:
    """A parameter's number; None where it is no finite number, such as a texture."""
    return default if element is None else _finite(element.get("value"))


def _finite(text: str | None) -> float | None:
    value = number_of(text)
    return value if value is not None and math.isfinite(value) else None


def colour(element: SceneElement | None, default: float) -> Colour | None:
    """A parameter's linear RGB; None where it is no constant colour."""
    if element is None:
        return (default,) * 3
    if element.tag not in ("float", "rgb", "spectrum") or "type" in element.attrib:
        return None
    values = numbers(element.get("value", "")) or ()
    return {1: values * 3, 3: values}.get(len(values))  # type: ignore[return-value]  # three numbers


def shown(values: Iterable[float]) -> str:
    """Numbers as a document has them."""
    return ", ".join(f"{value:.7g}" for value in values)


def linear(code: str) -> Colour | None:
    """Linear RGB of '#rrggbb', which is sRGB."""
    if not re.fullmatch("#[0-9a-fA-F]{6}", code):
        return None
    return linear_rgb(int(code[i : i + 2], 16) / 255 for i in (1, 3, 5))


def linear_rgb(srgb: Iterable[float]) -> Colour:
    """Linear RGB of sRGB in [0, 1]."""
    red, green, blue = srgb_to_linear(torch.tensor(list(srgb), dtype=torch.float64)).tolist()
    return red, green, blue


def blackbody(kelvin: float, scale: float) -> str:
    """Radiance in W / (m^2 sr nm) by Planck's law, as Mitsuba 0.6 has it: 'wavelength:value, ...' in nm."""
    metres = np.array(_WAVELENGTHS) * 1e-9
    exponent = _PLANCK * _LIGHT / (_BOLTZMANN * kelvin * metres)
    with np.errstate(over="ignore"):
        radiance = 2e-9 * scale * _PLANCK * _LIGHT**2 / metres**5 / np.expm1(exponent)
    return ", ".join(f"{nm}:{value:.7g}" for nm, value in zip(_WAVELENGTHS, radiance, strict=True))

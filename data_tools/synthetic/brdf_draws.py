"""Random draws of both synthetic BRDF sets, isotropic and anisotropic.

Both sets give a material its hue, roughness and lightness here, and its name. Reflection models are not known here.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from torch import Tensor

from data_tools.synthetic.brdf_models import Rgb
from data_tools.synthetic.random_values import Split
from metapp.appearance.reflection import MicrofacetKind

COUNTS: dict[Split, int] = {"train": 80, "test": 20}


class SyntheticBrdf(NamedTuple):
    """A material of a synthetic set: its name and its BRDF as a function.

    Attributes:
        name: family, description, and a number that is unique within the split ("t" before it: test).
        evaluate: function from angles [..., 3] (anisotropic: [..., 4]) in rad to the BRDF [..., 3] in 1/sr, linear RGB,
            >= 0; 0 below the horizon.
    """

    name: str
    evaluate: Callable[[Tensor], Tensor]


class Draws:
    """The uniform numbers of one material: three spread evenly over its family, the others independent.

    Args:
        split: the split of the set.
        seed: the seed of the set.
        family: the number of the material's family.
        member: the number of the material in its family.

    Attributes:
        hue, roughness, lightness: the three numbers, in [0, 1).
    """

    def __init__(self, split: Split, seed: int, family: int, member: int) -> None:
        key = [seed, list(COUNTS).index(split), family]
        shift = np.random.Generator(np.random.PCG64(np.random.SeedSequence(key))).random(3)
        # Kronecker sequences: the golden ratio for the hue, for the other two its generalisation to the plane (Roberts
        # 2018).
        spread = (shift + member * np.array([0.6180339887498949, 0.7548776662466927, 0.5698402909980532])) % 1
        self.hue, self.roughness, self.lightness = (float(value) for value in spread)
        self._rest = np.random.Generator(np.random.PCG64(np.random.SeedSequence([*key, member])))

    def between(self, low: float, high: float) -> float:
        """Draw a number evenly from [low, high)."""
        return low + (high - low) * float(self._rest.random())

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return float(self._rest.random()) < probability

    def alpha(self, low: float, high: float) -> float:
        """Return the roughness between `low` and `high`, spread evenly over its logarithm within the family."""
        roughness: float = low * (high / low) ** self.roughness
        return roughness

    def kind(self) -> MicrofacetKind:
        """Draw the kind of microfacets: "ggx" in 65 % of draws, else "beckmann"."""
        return "ggx" if self.chance(0.65) else "beckmann"

    def colour(self, darkest: float = 0.03, brightest: float = 0.9, saturation: tuple[float, float] = (0.1, 1)) -> Rgb:
        """Draw a linear RGB albedo of the material's hue, its brightest channel between `darkest` and `brightest`."""
        srgb_value = (darkest ** (1 / 2.2)) + (brightest ** (1 / 2.2) - darkest ** (1 / 2.2)) * self.lightness
        depth = self.between(*saturation) * (
            0.15 if self.chance(0.15) else 1.0
        )  # 15 % of the colours are nearly neutral
        red, green, blue = (channel**2.2 for channel in colorsys.hsv_to_rgb(self.hue, depth, srgb_value))
        return red, green, blue


def colour_name(linear_rgb: Rgb) -> str:
    """Return the name of a linear RGB colour: a hue, or black, grey or white."""
    hue, saturation, value = colorsys.rgb_to_hsv(*(channel ** (1 / 2.2) for channel in linear_rgb))
    if value < 0.22:
        return "black"
    if saturation < 0.2:
        return "white" if value > 0.85 else "grey"
    names = ("red", "orange", "yellow", "lime", "green", "teal", "cyan", "azure", "blue", "violet", "magenta", "rose")
    name = names[round(hue * 12) % 12]
    return "brown" if name in ("red", "orange") and value < 0.6 and saturation > 0.3 else name


def roughness_name(alpha: float) -> str:
    """Return the name of a roughness: polished, satin, brushed or rough."""
    return "polished" if alpha < 0.07 else "satin" if alpha < 0.16 else "brushed" if alpha < 0.32 else "rough"

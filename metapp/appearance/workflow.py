"""The metallic-roughness workflow: diffuse and specular colour as base colour and metallic, and back.

A texel is a mixture of a dielectric of specular reflectance c = 0.04 and a metal, as in glTF 2.0's core materials:

    diffuse = base (1 - metallic)        F0 = c (1 - metallic) + base metallic
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

DIELECTRIC = 0.04  # reflectance at normal incidence of nearly all that is no metal


class MetallicRoughness(NamedTuple):
    """Colours of the workflow.

    Attributes:
        base: [..., 3, H, W] linear RGB in [0, 1].
        metallic: [..., 1, H, W] in [0, 1].
    """

    base: Tensor
    metallic: Tensor


def from_metallic(base: Tensor, metallic: Tensor) -> tuple[Tensor, Tensor]:
    """Diffuse and specular colour [..., 3, H, W] of the workflow's maps."""
    return base * (1 - metallic), DIELECTRIC * (1 - metallic) + base * metallic


def to_metallic(diffuse: Tensor, specular: Tensor) -> MetallicRoughness:
    """The workflow's maps of diffuse and specular colour.

    Eliminating the base colour leaves c m^2 + (d + s - 2 c) m - (s - c) = 0, linear in d and s: it is solved for their
    means over the channels. The base colour is then d + s - c (1 - m). Both are exact where such maps exist
    (`from_metallic` inverts them); elsewhere they are clamped to [0, 1]: a specular colour below 0.04 or of another hue
    than the body's is lost, which is why formats that can hold F0 itself get that.

    Args:
        diffuse: [..., 3, H, W] linear in [0, 1].
        specular: [..., 1 or 3, H, W], reflectance at normal incidence in [0, 1].
    """
    d, s = diffuse.mean(-3, keepdim=True), specular.mean(-3, keepdim=True)
    linear = d + s - 2 * DIELECTRIC
    root = (linear * linear + 4 * DIELECTRIC * (s - DIELECTRIC)).clamp_min(0).sqrt()
    metallic = ((root - linear) / (2 * DIELECTRIC)).clamp(0, 1)
    metallic = metallic.where(s > DIELECTRIC, metallic.new_zeros(()))
    base = (diffuse + specular - DIELECTRIC * (1 - metallic)).clamp(0, 1)
    return MetallicRoughness(base, metallic)

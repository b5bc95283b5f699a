"""Maps of a flat material: their raw parameters, which are unbounded numbers, and how far two are apart.

Here are also places of lights and viewers under which maps are compared, and what networks read of photographs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, pad

from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.flash import camera_distance, texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.learning.random_tensors import draw_uniform

# Channels of the raw parameters of a texel: slopes, diffuse colour, roughness, specular colour
CHANNELS = (2, 3, 1, 3)
ROUGHNESS_CHANNEL = CHANNELS[0] + CHANNELS[1]
PIXEL_INPUTS = 8  # numbers of a pixel of a photograph that fields and encoders read
MIN_ROUGHNESS = 0.05  # the roughness of maps, whose square is alpha of GGX, is not below
CLIPPED_LINEAR_VALUE = 0.95  # linear value, 1 is white, from which on a photograph may be clipped
MIN_NORMAL_Z = 0.2  # z of normals by which slopes stay below 5
MIN_COSINE = 0.4  # cosine with the patch's normal of the most oblique light or view
CONTRAST_CELLS = 64  # a picture's side over the distance of the neighbours that contrasts are taken of


def decode_maps(raw: Tensor) -> Maps:
    """Return the maps [T, C, H, W] of raw parameters [T, 9, H, W]; inverts :func:`encode_maps`."""
    slopes, diffuse, roughness, specular = raw.split(CHANNELS, 1)
    return Maps(
        torch.sigmoid(diffuse) ** 2.2,  # so that outputs are about evenly spread for the eye
        torch.sigmoid(specular - 2) ** 2,  # about 0.02 at first, like dielectrics
        MIN_ROUGHNESS + (1 - MIN_ROUGHNESS) * torch.sigmoid(roughness),
        normalise(torch.cat([slopes, torch.ones_like(roughness)], 1)),
    )


def encode_maps(maps: Maps) -> Tensor:
    """Return the raw parameters [T, 9, H, W] of maps [T, C, H, W]; inverts :func:`decode_maps`.

    Ends of ranges, which no raw parameter reaches, are moved inwards: colours by 2 % in steps that look even, see
    :func:`decode_maps`, roughness by 1 %. Normals whose z is below 0.1 become less steep.
    """
    slopes = maps.normal[:, :2] / maps.normal[:, 2:].clamp_min(0.1)
    # `decode_maps` subtracts 2 from the numbers of the specular colour, so that 0 is a dielectric.
    specular = torch.logit(maps.specular.clamp(1e-4, 1).sqrt().clamp(0.02, 0.98)) + 2
    return torch.cat([slopes, encode_diffuse(maps.diffuse), encode_roughness(maps.roughness), specular], 1)


def encode_diffuse(diffuse: Tensor) -> Tensor:
    """Return the raw parameters of a diffuse colour of any shape; see :func:`encode_maps`."""
    return torch.logit((diffuse.clamp(1e-4, 1) ** (1 / 2.2)).clamp(0.02, 0.98))


def encode_roughness(roughness: Tensor) -> Tensor:
    """Return the raw parameter of a roughness of any shape; see :func:`encode_maps`."""
    return torch.logit(((roughness - MIN_ROUGHNESS) / (1 - MIN_ROUGHNESS)).clamp(0.01, 0.99))


def decode_photo(photo: Tensor) -> Tensor:
    """Convert a photograph of any shape from uint8 sRGB, as tasks hold it, to linear RGB."""
    # a table of the 256 levels, each of which a large photograph has many times
    levels = srgb_to_linear(torch.arange(256, device=photo.device) / 255)
    return levels[photo.int()]


def scale_size(picture: Tensor, shorter: int) -> tuple[int, int]:
    """Return the height and width to which a picture [..., H, W] is scaled if its shorter side becomes `shorter` px.

    >>> scale_size(torch.zeros(3, 480, 640), 240)
    (240, 320)
    """
    height, width = picture.shape[-2:]
    return round(height * shorter / min(height, width)), round(width * shorter / min(height, width))


def pool_maps(maps: Tensor, size: Sequence[int]) -> Tensor:
    """Average packed maps [..., 10, H, W] over areas to another size (height, width), with normals of unit length."""
    normal, rest = adaptive_avg_pool2d(maps, (size[0], size[1])).split((3, 7), -3)
    return torch.cat([normalise(normal), rest], -3)


def normalise(vectors: Tensor) -> Tensor:
    """Scale vectors [..., 3, H, W] to length 1; many times as fast as torch's own function, as channels come first."""
    return vectors * vectors.square().sum(-3, keepdim=True).clamp_min(1e-24).rsqrt()


def find_slopes(normals: Tensor) -> Tensor:
    """Return x and y over z of normals [T, 3, H, W], with z raised to at least MIN_NORMAL_Z: [T, 2, H, W]."""
    return normals[:, :2] / normals[:, 2:].clamp_min(MIN_NORMAL_Z)


def map_differences(maps: Maps, target: Maps) -> Maps:
    """Return the differences of each map of two sets, [T, C, H, W], of colours at gamma 2.2."""
    diffuse, specular = (
        _encode_gamma(colour) - _encode_gamma(target_colour)
        for colour, target_colour in zip(maps[:2], target[:2], strict=True)
    )
    return Maps(diffuse, specular, maps.roughness - target.roughness, maps.normal - target.normal)


def _encode_gamma(colour: Tensor) -> Tensor:
    return (colour + 1e-3) ** (1 / 2.2)


def draw_oblique_pairs(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Draw places of a light and of a viewer, independent of each other, [*shape, 2, 3] in half sides of the patch."""
    return camera_distance() * _draw_directions(rng, (*shape, 2))


def draw_mirroring_pairs(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Draw places of a light and of a viewer who sees it mirrored in a smooth patch, [*shape, 2, 3] in half sides."""
    centre = 1.6 * draw_uniform(rng, *shape, 2) - 0.8
    centre = torch.cat([centre, torch.zeros_like(centre[..., :1])], -1)
    directions = _draw_directions(rng, shape)
    mirrored_directions = directions * directions.new_tensor([-1.0, -1.0, 1.0])
    return torch.stack([centre + camera_distance() * direction for direction in (directions, mirrored_directions)], -2)


def _draw_directions(rng: Generator, shape: tuple[int, ...]) -> Tensor:
    """Draw unit vectors [*shape, 3], even in solid angle, whose z, along the normal, is at least MIN_COSINE."""
    z, turns = draw_uniform(rng, 2, *shape)
    z, phi = MIN_COSINE + (1 - MIN_COSINE) * z, 2 * math.pi * turns
    sine = (1 - z * z).sqrt()
    return torch.stack([sine * phi.cos(), sine * phi.sin(), z], -1)


def pixel_inputs(photo: Tensor) -> Tensor:
    """Return what fields and encoders read of each pixel of linear photographs [T, 3, H, W]: [T, PIXEL_INPUTS, H, W].

    These are the logs of its colour, contrasts of its brightness with four neighbours, and its position. Neighbours
    have one distance in the patch at every resolution, so that a field fitted at one resolution works at others.
    """
    logs = (photo + 0.02).log()
    distance = max(1, min(photo.shape[-2:]) // CONTRAST_CELLS)
    padded = pad(logs.mean(1, keepdim=True), (distance, distance, distance, distance), mode="replicate")
    inner, after = slice(distance, -distance), slice(2 * distance, None)
    before = slice(None, -2 * distance)
    left, right = padded[..., inner, before], padded[..., inner, after]
    above, below = padded[..., before, inner], padded[..., after, inner]
    centre = padded[..., inner, inner]
    contrasts = [right - left, above - below, 4 * centre - left - right - above - below]
    place = texel_positions(*photo.shape[-2:], dtype=photo.dtype, device=photo.device).expand(len(photo), -1, -1, -1)
    return torch.cat([logs / 1.5 + 1, *contrasts, place], 1)

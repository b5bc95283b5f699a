"""Domes: materials with relief, photographed by a camera that stands still under many lamps, for training.

The format `domes` reads materials as `materials` does. A material's relief is enlarged or flattened, laid over smooth
waves and raised figures, and photographed under lamps all around by :mod:`metapp.rendering.relief`. What is drawn
depends on the name of the material alone.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from data_tools.random_streams import Rng, random_stream
from data_tools.readers import material_maps
from data_tools.readers.input_source import Sources
from data_tools.readers.material_files import MaterialFiles, material_of
from data_tools.readers.svbrdf_task import LAMP_UNITS, encode_srgb
from data_tools.readers.training_materials import read_task as read_material
from data_tools.synthetic.random_values import between, chance, log_between
from metapp.appearance.height_fields import height_from_normal
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.learning.task import Task
from metapp.rendering.relief import SEEN_HALF_SIDE, light_relief
from metapp.storage.shards import ManifestEntry

UNITS = LAMP_UNITS
RELIEF_PX = 512  # side of the material
LOWEST_LAMP_DEGREES = 8.0
GOLDEN_ANGLE_RAD = math.pi * (3 - math.sqrt(5))  # turns by it, lamps at rising heights are spread evenly
LEAST_ROUGHNESS = 0.1  # a few samples a pixel do not find sharper reflections of lamps
WHITE_QUANTILE = 0.98  # of all radiance, which the exposure makes about white
READ_NOISE, SHOT_NOISE = 0.002, 0.004  # deviations of linear values: of dark pixels, and of white ones


def find(path: Path) -> Sources:
    """Find one file of each set of maps; see :func:`material_maps.find`."""
    return material_maps.find(path)


def entries(sources: Sequence[Path], folders: Iterable[Path], split: str) -> dict[Path, ManifestEntry]:
    """Return the manifest's entry of each material; see :func:`material_maps.entries`."""
    return material_maps.entries(sources, folders, split)


def read_task(
    source: Path, size: int, lamps: int, normals: str, layer: str = "", content: MaterialFiles | None = None
) -> Task:
    """Read the material that a map belongs to, and photograph it under lamps.

    Args:
        source: one of the material's maps.
        size: the side of the photographs, in px.
        lamps: the number of lamps.
        normals: where green points in normal maps; see :func:`material_maps.read_task`.
        layer: the layer of EXR files; see :func:`data_tools.readers.image_files.read_pixels`.
        content: the material, as :func:`find` found it; None to look for it.

    Returns:
        `photo`, the mean of all photographs, `lit`, the photographs, `lamps` and `maps`; see LAMP_UNITS. Colours of
        `maps` are relative to the exposure: pictures of them are as bright as the photographs.

    Raises:
        ValueError: the maps cannot be read, or Mitsuba cannot be imported.
    """
    task = read_material(source, RELIEF_PX, normals, layer, content or material_of(source))
    rng = random_stream(zlib.crc32(task.name.encode()))
    maps = _vary_reflectance(rng, unpack_maps(task.data["maps"].float()))
    directions = _draw_lamps(rng, lamps)
    lit = light_relief(maps, _draw_relief(rng, maps.normal), directions, size, int(rng.integers(2**20)))
    exposure = between(rng, 0.6, 1.1) / float(np.quantile(lit.radiance.numpy(), WHITE_QUANTILE))
    photos = encode_srgb(_add_noise(rng, (lit.radiance * exposure).clamp(0, 1)))
    seen = _crop_and_pool(maps, size)
    true_maps = Maps(
        (seen.diffuse * exposure).clamp(0, 1), (seen.specular * exposure).clamp(0, 1), seen.roughness, lit.normal
    )
    mean_photo = encode_srgb((lit.radiance * exposure).clamp(0, 1).mean(0))
    return Task(
        task.name, {"photo": mean_photo, "lit": photos, "lamps": directions, "maps": pack_maps(true_maps).half()}
    )


def _vary_reflectance(rng: Rng, maps: Maps) -> Maps:
    """Polish some materials, and make some of metal, or of one colour: scans are rough and dull for the most part."""
    diffuse, specular, roughness = maps.diffuse, maps.specular, maps.roughness
    if chance(rng, 0.35):
        roughness = roughness * between(rng, 0.25, 0.8)
    if chance(rng, 0.2):
        roughness = torch.full_like(roughness, between(rng, 0.15, 0.6))
    if chance(rng, 0.3):  # a statue, a cast
        mean = diffuse.mean((1, 2), keepdim=True)
        diffuse = mean + between(rng, 0, 0.3) * (diffuse - mean)
    if chance(rng, 0.2):
        share = between(rng, 0.5, 1)
        specular = torch.lerp(specular, torch.maximum(specular, diffuse.clamp(0.2, 0.95)), share)
        diffuse = diffuse * (1 - share)
    return maps._replace(diffuse=diffuse, specular=specular, roughness=roughness.clamp(LEAST_ROUGHNESS, 1))


def _draw_relief(rng: Rng, normal: Tensor) -> Tensor:
    """Draw a height [M, M] in half sides that continues at the opposite edge, given the normals of a material."""
    fine = height_from_normal(normal[None], periodic=True)[0, 0] / (normal.shape[-1] / 2)
    height = between(rng, 0.1 if chance(rng, 0.3) else 0.5, 1.5) * fine
    if chance(rng, 0.8):
        height = height + log_between(rng, 0.06, 0.5) * _draw_waves(rng, log_between(rng, 2, 11))
    if chance(rng, 0.4):  # raised figures with flanks
        figures = _draw_waves(rng, log_between(rng, 3, 11))
        steepness = between(rng, 2, 12)
        height = height + between(rng, 0.02, 0.15) * torch.sigmoid(steepness * figures / figures.std())
    return (height - height.max()).float()


def _draw_waves(rng: Rng, frequency: float) -> Tensor:
    """Draw a smooth random height [M, M], whose slopes along an axis have a root mean square of 1, in half sides."""
    noise = torch.from_numpy(rng.random((RELIEF_PX, RELIEF_PX))) - 0.5
    waves = torch.fft.fftfreq(RELIEF_PX, 1 / RELIEF_PX, dtype=torch.float64)
    radius = torch.hypot(waves[None, :], waves[:, None])
    spectrum = (-((radius / frequency) ** 2)).exp() * (radius > 0)
    height: Tensor = torch.fft.ifft2(torch.fft.fft2(noise) * spectrum).real
    slopes = torch.stack([torch.roll(height, -1, axis) - height for axis in (0, 1)]) * (RELIEF_PX / 2)
    slope: Tensor = slopes.square().mean().sqrt()
    return height / slope


def _draw_lamps(rng: Rng, count: int) -> Tensor:
    """Draw unit vectors [count, 3] towards lamps all around, about evenly spread, from LOWEST_LAMP_DEGREES upwards."""
    lowest = math.sin(math.radians(LOWEST_LAMP_DEGREES))
    z = lowest + (1 - lowest) * (np.arange(count) + rng.random(count)) / count
    turn_rad = np.arange(count) * GOLDEN_ANGLE_RAD + 2 * math.pi * rng.random() + 0.5 * (rng.random(count) - 0.5)
    sine = np.sqrt(1 - z * z)
    return torch.from_numpy(np.stack([sine * np.cos(turn_rad), sine * np.sin(turn_rad), z], 1)).float()


def _add_noise(rng: Rng, radiance: Tensor) -> Tensor:
    """Add the noise of a camera to linear values."""
    # sums of four even numbers are close to Gaussian ones, and equal on every machine
    noise = sum(rng.random(radiance.shape, dtype=np.float32) for _ in range(4)) - np.float32(2)
    deviation = READ_NOISE + SHOT_NOISE * radiance.sqrt()
    return radiance + deviation * math.sqrt(3) * torch.from_numpy(noise)


def _crop_and_pool(maps: Maps, size: int) -> Maps:
    """Return the maps [C, size, size] of the part that the camera sees, averaged over pixels."""
    margin = round(RELIEF_PX * (1 - SEEN_HALF_SIDE) / 2)
    parts = (part[None, :, margin : RELIEF_PX - margin, margin : RELIEF_PX - margin] for part in maps)
    return Maps(*(interpolate(part, (size, size), mode="bilinear", antialias=True)[0] for part in parts))

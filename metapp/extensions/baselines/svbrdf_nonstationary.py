"""Baselines of non-stationary svBRDFs: picture files of the maps; of a photo, the nearest material, or itself, flat."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, normalize

from metapp.appearance.flash import Maps, unpack
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines.baseline import (
    Allowed,
    Baseline,
    BaselineFit,
    PreparedBaseline,
    Training,
    nearest_photo,
    within_size,
)
from metapp.learning.app import App
from metapp.learning.task import Tasks

GAMMA = 2.2  # colours in files, as the eye spaces them
SMALLEST = 4  # px of a side
ROUGHNESS, F0 = 0.5, 0.04  # of what a photo says nothing of: the middle, and that of most dielectrics


def jpeg(picture: np.ndarray, quality: int) -> bytes:
    """A JPEG of a picture [H, W, 1 or 3] in [0, 1], quality 1 to 100, colours as fine as brightness."""
    settings = {"Compression": f"jpeg:{quality}", "jpeg:subsampling": "4:4:4"}
    return _encoded(picture, ".jpg", "uint8", settings)


def png(picture: np.ndarray, bits: int) -> bytes:
    """A PNG of a picture [H, W, 1 or 3] in [0, 1], of 8 or 16 bits, compressed as far as it goes."""
    return _encoded(picture, ".png", f"uint{bits}", {"png:compressionLevel": 9, "png:filter": 0xF8})


def decoded(file: bytes, suffix: str) -> np.ndarray:
    """The picture [H, W, 1 or 3] of a file, in [0, 1]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{suffix}")
        path.write_bytes(file)
        pixels = oiio.ImageBuf(str(path)).get_pixels("float")
    assert pixels is not None
    return pixels


def _encoded(picture: np.ndarray, suffix: str, kind: str, settings: Mapping[str, str | int]) -> bytes:
    spec = oiio.ImageSpec(picture.shape[1], picture.shape[0], picture.shape[2], kind)
    for key, value in settings.items():
        spec.attribute(key, value)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{suffix}")
        output = oiio.ImageOutput.create(str(path))
        assert output is not None, suffix
        done = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(picture, np.float32))
        if not (output.close() and done):
            raise OSError(f"a picture as {suffix}: {output.geterror()}")
        return path.read_bytes()


class Sheets(NamedTuple):
    """Maps as pictures in [0, 1]: diffuse and specular [H, 2 W, 3]; normals' x and y and roughness [H, 3 W, 1]."""

    colours: np.ndarray
    shapes: np.ndarray


class PngSetting(NamedTuple):
    """Texels of a side, and bits a channel, of a PNG."""

    side: int
    bits: int


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of maps, or of photographs, by the protocol."""
    if app.protocol == "photo":
        title = "the training material whose photograph is nearest (mean absolute difference of logs)"
        flat = f"the photo without the flash's falloff as diffuse map, flat, of roughness {ROUGHNESS} and F0 {F0}"
        return (
            Baseline("nearest", title, "be a material that is not in its set", _nearest),
            Baseline(
                "flat",
                flat,
                "tell highlights and shading from colour",
                lambda training, allowed: PreparedBaseline(_flat),
                learns=False,
            ),
            Baseline(
                "predicted",
                "the maps that another method predicts of the photo, as `metapp data strips --predicted` reads them",
                "be made of another photo here, as its network is not at hand",
                lambda training, allowed: PreparedBaseline(_predicted, shared=None),
                learns=False,
                stored="predicted",
            ),
        )
    cannot = "read maps from a photo"

    def as_jpeg(tasks: Tasks, rung: int) -> BaselineFit:
        return _kept([jpeg(sheet, rung + 1) for sheet in sheets(_maps(tasks))], ".jpg", lambda maps: maps)

    return (
        within_size("jpeg", "JPEGs of the maps, of the quality that fits", cannot, lambda _: 100, as_jpeg),
        within_size("png", "PNGs of the maps, of fewer bits, then texels, until they fit", cannot, _count, _png),
    )


def sheets(maps: Maps) -> Sheets:
    """Maps [1, C, H, W] as display values, side by side; of unit normals x and y say it all."""
    colours = torch.cat([colour.clamp(0, 1) ** (1 / GAMMA) for colour in maps[:2]], 3)
    shapes = torch.cat([maps.normal[:, :1] * 0.5 + 0.5, maps.normal[:, 1:2] * 0.5 + 0.5, maps.roughness], 3)
    return Sheets(*(sheet[0].permute(1, 2, 0).numpy() for sheet in (colours, shapes)))


def maps_of(pictures: Sheets) -> Maps:
    """The inverse of `sheets`."""
    colours, shapes = (torch.from_numpy(sheet).permute(2, 0, 1)[None] for sheet in pictures)
    diffuse, specular = (colours**GAMMA).chunk(2, 3)
    x, y, roughness = shapes.chunk(3, 3)
    x, y = x * 2 - 1, y * 2 - 1
    z = (1 - x * x - y * y).clamp_min(1e-4).sqrt()
    return Maps(diffuse, specular, roughness, normalize(torch.cat([x, y, z], 1), dim=1))


def _maps(tasks: Tasks) -> Maps:
    return unpack(tasks.data["maps"][tasks.rows])


def _kept(files: Sequence[bytes], suffix: str, after: Callable[[Maps], Maps]) -> BaselineFit:
    """Both files, and what their maps go through."""

    def answer() -> Maps:
        return after(maps_of(Sheets(*(decoded(file, suffix) for file in files))))

    return BaselineFit(answer, None, sum(map(len, files)))


def _settings(side: int) -> list[PngSetting]:
    """Those of PNGs of maps of so many texels a side: more texels, then more bits."""
    sides = {round(side * 2 ** (-i / 4)) for i in range(64)}
    return [*(PngSetting(fewer, 8) for fewer in sorted(sides) if fewer >= SMALLEST), PngSetting(side, 16)]


def _count(tasks: Tasks) -> int:
    return len(_settings(_maps(tasks).diffuse.shape[-1]))


def _png(tasks: Tasks, rung: int) -> BaselineFit:
    maps = _maps(tasks)
    full = maps.diffuse.shape[-1]
    side, bits = _settings(full)[rung]
    small = Maps(*(adaptive_avg_pool2d(part, side) for part in maps))
    return _kept([png(sheet, bits) for sheet in sheets(small)], ".png", lambda maps: _enlarged(maps, full))


def _enlarged(maps: Maps, side: int) -> Maps:
    """Maps of so many texels a side; normals of unit length."""
    wide = Maps(*(interpolate(part, size=(side, side), mode="bilinear") for part in maps))
    return wide._replace(normal=normalize(wide.normal, dim=1))


def _nearest(training: Training, allowed: Allowed) -> PreparedBaseline:
    return nearest_photo(training, "maps", unpack, lambda photos: (photos + 0.02).log())


def _flat(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    photo = tasks.data["photo"][tasks.rows]
    return BaselineFit(lambda: flat_maps(photo), photo.numel(), photo.numel())


def _predicted(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    if "predicted" not in tasks.data:
        (name,) = tasks.picked_names
        raise ValueError(f"{name}: no predicted maps, expected some; convert it by metapp data strips --predicted.")
    maps = tasks.data["predicted"][tasks.rows]
    return BaselineFit(lambda: unpack(maps), maps.numel(), maps.numel())


def flat_maps(photos: Tensor) -> Maps:
    """What photographs [T, 3, H, W], linear, would be of if it had no highlight and no relief, [T, C, H, W] each."""
    one = torch.ones_like(photos)
    flat = Maps(one, F0 * one, ROUGHNESS * one[:, :1], torch.cat([0 * one[:, :2], one[:, :1]], 1))
    beside_lens = flash_of(photos.new_zeros(len(photos), FLASH))
    white = photographed(flat._replace(specular=0 * one, roughness=one[:, :1]), beside_lens)
    return flat._replace(diffuse=(photos / white).clamp(0, 1))

"""Baselines of non-stationary svBRDFs: picture files of the maps; of a photo, the nearest material, or itself, flat."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

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
from metapp.storage.files import read_bytes

GAMMA = 2.2  # colours in files, as the eye spaces them
ROUGHNESS, F0 = 0.5, 0.04  # of what a photo says nothing of: the middle, and that of most dielectrics


def jpeg(picture: np.ndarray, quality: int) -> bytes:
    """A JPEG of a picture [H, W, 1 or 3] in [0, 1], quality 1 to 100, colours as fine as brightness."""
    spec = oiio.ImageSpec(picture.shape[1], picture.shape[0], picture.shape[2], "uint8")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.jpg")
        output = oiio.ImageOutput.create(str(path))
        assert output is not None
        done = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(picture, np.float32))
        if not (output.close() and done):
            raise OSError(f"a picture as JPEG: {output.geterror()}")
        return read_bytes(path)


def decoded(file: bytes) -> np.ndarray:
    """The picture [H, W, 1 or 3] of a JPEG, in [0, 1]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "picture.jpg")
        path.write_bytes(file)
        pixels = oiio.ImageBuf(str(path)).get_pixels("float")
    assert pixels is not None
    return pixels


class Sheets(NamedTuple):
    """Maps as pictures in [0, 1]: diffuse and specular [H, 2 W, 3]; normals' x and y and roughness [H, 3 W, 1]."""

    colours: np.ndarray
    shapes: np.ndarray


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
    title = "JPEGs of the maps, of the quality that fits"
    return (within_size("jpeg", title, "read maps from a photo", lambda _: 100, _as_jpeg),)


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


def _as_jpeg(tasks: Tasks, rung: int) -> BaselineFit:
    files = [jpeg(sheet, rung + 1) for sheet in sheets(unpack(tasks.data["maps"][tasks.rows]))]
    return BaselineFit(lambda: maps_of(Sheets(*map(decoded, files))), None, sum(map(len, files)))


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
    """Maps [T, C, H, W] of photographs [T, 3, H, W], linear, as of a surface without highlight and relief."""
    one = torch.ones_like(photos)
    flat = Maps(one, F0 * one, ROUGHNESS * one[:, :1], torch.cat([0 * one[:, :2], one[:, :1]], 1))
    beside_lens = flash_of(photos.new_zeros(len(photos), FLASH))
    white = photographed(flat._replace(specular=0 * one, roughness=one[:, :1]), beside_lens)
    return flat._replace(diffuse=(photos / white).clamp(0, 1))

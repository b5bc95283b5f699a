"""Baselines of non-stationary svBRDFs: picture files of the maps; of a photo, the nearest training material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, normalize

from metapp.appearance.flash import Maps, unpack
from metapp.baselines.baseline import Allowed, Baseline, Codec, Fitted, Prepared, Training, both_ways, bytes_of, nearest
from metapp.baselines.methods import codec
from metapp.learning.app import App
from metapp.learning.task import Tasks

GAMMA = 2.2  # colours in files, as the eye spaces them
SMALLEST = 4  # px of a side


class Sheets(NamedTuple):
    """Maps as pictures in [0, 1]: diffuse and specular [H, 2 W, 3]; normals' x and y and roughness [H, 3 W, 1]."""

    colours: np.ndarray
    shapes: np.ndarray


class Setting(NamedTuple):
    """Texels of a side, and bits a channel, of a PNG."""

    side: int
    bits: int


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of maps, or of photographs, by the protocol."""
    if app.protocol == "photo":
        title = "the training material whose photograph is nearest (mean absolute difference of logs)"
        return (Baseline("nearest", title, "be a material that is not in its set", _nearest),)
    cannot = "read maps from a photo"
    found = [
        Codec("jpeg", "JPEGs of the maps, of the quality that fits", cannot, lambda _: 100, _jpeg),
        Codec("png", "PNGs of the maps, with fewer bits, then fewer texels, until they fit", cannot, _count, _png),
    ]
    return tuple(baseline for each in found for baseline in both_ways(each))


BASELINES = baselines


def sheets(maps: Maps) -> Sheets:
    """Maps [1, C, H, W] as display values, side by side; of unit normals x and y say it all."""
    colours = torch.cat([each.clamp(0, 1) ** (1 / GAMMA) for each in maps[:2]], 3)
    shapes = torch.cat([maps.normal[:, :1] * 0.5 + 0.5, maps.normal[:, 1:2] * 0.5 + 0.5, maps.roughness], 3)
    return Sheets(*(each[0].permute(1, 2, 0).numpy() for each in (colours, shapes)))


def maps_of(pictures: Sheets) -> Maps:
    """The inverse of `sheets`."""
    colours, shapes = (torch.from_numpy(each).permute(2, 0, 1)[None] for each in pictures)
    diffuse, specular = (colours**GAMMA).chunk(2, 3)
    x, y, roughness = shapes.chunk(3, 3)
    x, y = x * 2 - 1, y * 2 - 1
    z = (1 - x * x - y * y).clamp_min(1e-4).sqrt()
    return Maps(diffuse, specular, roughness, normalize(torch.cat([x, y, z], 1), dim=1))


def _maps(tasks: Tasks) -> Maps:
    return unpack(tasks.data["maps"][tasks.rows])


def _jpeg(tasks: Tasks, rung: int) -> Fitted:
    files = [codec.jpeg(each, rung + 1) for each in sheets(_maps(tasks))]
    return _kept(files, ".jpg", lambda maps: maps)


def _kept(files: Sequence[bytes], suffix: str, after: Callable[[Maps], Maps]) -> Fitted:
    """Both files, and what their maps go through."""

    def answer() -> Maps:
        return after(maps_of(Sheets(*(codec.decoded(each, suffix) for each in files))))

    return Fitted(answer, None, sum(map(len, files)))


def _settings(side: int) -> list[Setting]:
    """Those of PNGs of maps of so many texels a side: more texels, then more bits."""
    sides = {round(side * 2 ** (-i / 4)) for i in range(64)}
    fewer = [Setting(each, 8) for each in sorted(sides) if each >= SMALLEST]
    return [*fewer, Setting(side, 16)]


def _count(tasks: Tasks) -> int:
    return len(_settings(_maps(tasks).diffuse.shape[-1]))


def _png(tasks: Tasks, rung: int) -> Fitted:
    maps = _maps(tasks)
    full = maps.diffuse.shape[-1]
    side, bits = _settings(full)[rung]
    small = Maps(*(adaptive_avg_pool2d(each, side) for each in maps))
    return _kept([codec.png(each, bits) for each in sheets(small)], ".png", lambda found: _enlarged(found, full))


def _enlarged(maps: Maps, side: int) -> Maps:
    """Maps of so many texels a side; normals of unit length."""
    wide = Maps(*(interpolate(each, size=(side, side), mode="bilinear") for each in maps))
    return wide._replace(normal=normalize(wide.normal, dim=1))


def _nearest(training: Training, allowed: Allowed) -> Prepared:
    """The set itself is shared."""
    app = training.app

    def logs(photos: Tensor) -> Tensor:
        return (photos + 0.02).log()

    prepared = [app.prepare(task) for task in training.holding("maps").tasks]
    photos = torch.stack([each["photo"] for each in prepared])
    maps = torch.stack([each["maps"] for each in prepared])

    def distances(tasks: Tasks, rng: Generator, allowed: Allowed) -> Tensor:
        return (logs(photos) - logs(tasks.data["photo"][tasks.rows])).abs().mean((1, 2, 3))

    return Prepared(nearest(distances, lambda index: unpack(maps[index][None])), bytes_of(photos, maps))

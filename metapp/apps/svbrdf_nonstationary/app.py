"""Non-stationary svBRDFs: maps of a flat material from photographs under a flash (paper section 4.1.4: from one)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, relu

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import (
    Maps,
    positions,
    render,
    statistics,
    tilt,
    unpack,
)
from metapp.appearance.highlight import FILL_PX, fill_clipped
from metapp.apps.svbrdf_nonstationary.encoder import Encoder
from metapp.apps.svbrdf_nonstationary.maps import (
    CLIPPED_VALUE,
    FLASH,
    INPUTS,
    RAW,
    Flash,
    decoded,
    differences,
    flash_of,
    inputs_of,
    linear,
    mirroring_pairs,
    oblique_pairs,
    photographed,
    pooled,
)
from metapp.apps.svbrdf_nonstationary.variants import photographs, varied
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import CodedApp, norm
from metapp.networks.field import LocalField, field_by_rows

RADIANCE_FLOOR = 0.1  # of white: the log of radiance is flat below
LEVEL_SINE = 0.01  # sine of an angle that hardly shows
WANTED, SEEN = 0.3, 0.3  # and in the outer loss, beside the photograph's
STEEP, HIDDEN = 0.2, 0.3  # there, of how steep normals are, which a photo hardly shows, and of diffuse where it clips
STEEP_CELLS = 8  # a side, in which normals are as steep on average as they should be
RIG, JUDGED = (2, 3), (6, 6)  # lights that fits see, and that they are judged under: oblique, mirroring
DRAWN = (1, 2)  # and those that preparation draws
SMOOTHED = 0.03  # at first, where learned losses round off |d|
FINER, FINEST_SHOT_PX = 2, 256  # augmented materials are photographed so many times as fine as their maps, up to px
FINEST_PX = 2048  # a side of a user's photograph


def field_of(side: int, hidden: int) -> LocalField:
    """The network of maps of side x side texels, with so many hidden units."""
    return LocalField(
        side,
        side,
        inputs=INPUTS,
        outputs=sum(RAW),
        rows=side,  # a cell for each texel, so that a step moves each by itself
        columns=side,
        code=12,
        hidden=hidden,
        layers=2,
        frequency=2.0,
        periodic=False,
        gain=60.0,
    )


@dataclass(frozen=True)
class SvbrdfNonstationary(CodedApp):
    """One flat material a task, photographed from straight above with the flash beside the lens.

    The field makes maps of the photograph and the code at each place. Under the protocol "reference"
    a fit sees the material's maps and pictures under RIG lights; under "photo" the photograph alone, whose flash it
    looks for, too. `others` and `places`, of further photographs, are for the extension `several`.

    Attributes:
        encoder_width: channels of the encoder's level of 64 texels.
        encoder_size: side of the photograph that the encoder reads, 0 for the network's.
        encoder_finer: channels of the encoder's levels above that.
        sees_others: whether fits see `others`, too, and place the flash of each photograph.
    """

    encoder_width: int = 16
    encoder_size: int = 0
    encoder_finer: tuple[int, ...] = ()
    sees_others: ClassVar[bool] = False

    name = "svbrdf_nonstationary"
    title = "svBRDF non-stat."
    error_measure = ErrorMeasure(
        "mean absolute difference of log(radiance + 0.1) under 12 other lights, from elsewhere",
        further={
            "normal": "normals, degrees",
            "diffuse": "diffuse at gamma 2.2",
            "roughness": "roughness",
            "specular": "specular at gamma 2.2",
        },
    )
    tensors: ClassVar = {
        "photo": TensorSpec((3, "S", "S"), "uint8"),
        "maps": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "others": TensorSpec(("K", 3, "S", "S"), "uint8", optional=True),
        "predicted": TensorSpec((10, "M", "M"), low=-1.001, high=1.001, optional=True),
        "places": TensorSpec(("N", 2, 3), low=-1e3, high=1e3, optional=True),
    }

    @property
    def encoder(self) -> Encoder:
        return Encoder(self.encoder_width, self.network.code, self.encoder_finer)

    @property
    def read_size(self) -> int:
        return FINEST_PX if self.encoder_size or self.encoder_finer else 0

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`photo`, linear [3, H, W], and `maps` [10, H, W] with their radiance under RIG lights, `lit`.

        And `fine`, the maps that augmented ones are made of; `predicted`, another method's maps, which no fit sees.
        """
        size = (self.network.height, self.network.width)
        photo = {"photo": adaptive_avg_pool2d(linear(task.data["photo"]), size)}
        if "maps" in task.data:
            maps = task.data["maps"].float()
            described = self.described(pooled(maps, size)[None])
            fine = min(maps.shape[-1], 2 * self.shot_size)  # twice as large, to have room for crops
            kept = pooled(maps, (fine, fine)).half()
            if "predicted" in task.data:
                photo["predicted"] = pooled(task.data["predicted"].float(), size)
            return photo | {"fine": kept} | {key: value[0] for key, value in described.items()}
        if self.protocol == "reference":
            raise ValueError(
                f"{task.name}: a flash photo, expected a material's maps; give these or a strip, or leave --observe "
                "reference out."
            )
        return photo

    @property
    def shot_size(self) -> int:
        """Side in texels of augmented materials when they are photographed."""
        return max(self.network.height, min(FINER * self.network.height, FINEST_SHOT_PX))

    def described(self, maps: Tensor) -> dict[str, Tensor]:
        """Maps [T, 10, H, W]; if fits see them, RIG lights, `rig`, and the log of radiance under them, `lit`."""
        if self.protocol == "photo":
            return {"maps": maps}
        rig = _pairs(RIG).to(maps).expand(len(maps), -1, -1, -1)
        return {"maps": maps, "rig": rig, "lit": self._logs(unpack(maps), rig)}

    def init(self, rng: Generator, count: int) -> Params:
        return super().init(rng, count) | {"flash": torch.zeros(count, FLASH, device=rng.device)}

    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """The fitted maps [T, C, h, w] of photographs [T, 3, h, w], at the photographs' resolution."""
        height, width = photo.shape[-2:]
        return self.maps_from(self.network._replace(height=height, width=width)(theta, inputs_of(photo)))

    def maps_from(self, raw: Tensor) -> Maps:
        """The maps [T, C, h, w] of outputs of fields, [T, sum(RAW), h, w]."""
        return decoded(raw)

    @property
    def fills(self) -> bool:
        """True if maps are filled beneath clipped highlights: those of the size that people use, of photographs."""
        return bool(self.read_size) and self.protocol == "photo"

    def fill(self, maps: Maps, photo: Tensor) -> Maps:
        """Fill maps [T, C, h, w] where linear photographs [T, 3, h, w] clip; see :func:`fill_clipped`.

        Losses are of maps as fields make them: fits see there that the photograph is at least so bright.
        """
        if not self.fills:
            return maps
        small = adaptive_avg_pool2d(photo, min(FILL_PX, *photo.shape[-2:]))
        return fill_clipped(maps, linear_to_srgb(small))

    def final_maps(self, theta: Params, photo: Tensor) -> Maps:
        """Return the fitted maps [T, C, h, w] of linear photographs [T, 3, h, w], filled where these clip."""
        return self.fill(self.maps_of(theta, photo), photo)

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """All there is of each task; `pairs` [T, V, 2, 3] of light and viewer are random, for the outer loss."""
        drawn = {"pairs": draw_pairs(DRAWN, rng, len(tasks))} if "maps" in tasks.data else {}
        visible = {key: value for key, value in tasks.data.items() if key not in ("fine", "predicted")}
        return super().sample(replace(tasks, data=visible), rng, count) | drawn

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of maps and pictures, or of the photograph, by the protocol, [T]."""
        maps = self.maps_of(theta, batch["photo"])
        if self.protocol == "photo":
            return self._photo_loss(theta, maps, batch, learned)
        pictures = norm(self._logs(maps, batch["rig"]) - batch["lit"], learned)
        apart = differences(maps, unpack(batch["maps"]))
        return pictures.mean((1, 2, 3, 4)) + _map_loss(apart, learned)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the maps and their radiance under any light, whatever fits see, [T].

        How steep normals are counts, too: those with the least mean difference from all that a photo allows are flat.
        """
        maps, target = self.maps_of(theta, batch["photo"]), unpack(batch["maps"])
        logs, references = (self._logs(each, batch["pairs"]) for each in (maps, target))
        pictures = (logs - references).abs().mean((1, 2, 3, 4))
        photo = self._photo_loss(theta, maps, batch, {})
        steep = (_steepness(maps) / _steepness(target)).log().abs().mean((1, 2, 3))
        apart = differences(maps, target)
        hidden = blots(apart[0], batch["photo"])
        wanted = _map_loss(apart, {}) + _map_loss(apart[2:], {})  # roughness and normals twice: photos say less of them
        return pictures + WANTED * wanted + SEEN * photo + STEEP * steep + HIDDEN * hidden

    def _logs(self, maps: Maps, pairs: Tensor, place: Tensor | None = None) -> Tensor:
        """Log of radiance of maps [T, ...] under pairs of light and viewer [T or 1, V, 2, 3]: [T, V, 3, H, W].

        Of parts of the patch `place` [T, 2, H, W] has their positions.
        """
        if place is None:
            place = positions(*maps.diffuse.shape[-2:], dtype=pairs.dtype, device=pairs.device)[None]
        place = place[:, None]
        spread = Maps(*(part[:, None] for part in maps))
        return (render(spread, place, pairs[:, :, 0], pairs[:, :, 1]) + RADIANCE_FLOOR).log()

    def _photo_loss(self, theta: Params, maps: Maps, batch: Batch, learned: Params) -> Tensor:
        """Mean difference of the logs of the photograph, [T]; where it clips, only darker values count."""
        seen = photographed(maps, flash_of(self.network.gain * theta["flash"]), batch.get("place"))
        return photo_loss(seen, batch["photo"], learned)

    def loss_parameters(self, steps: int) -> Params:
        return {"smoothing": torch.full((steps,), math.log(SMOOTHED))}

    def init_reader(self, rng: Generator) -> Params:
        return self.encoder.init(rng)

    def read(self, reader: Params, photos: Tensor) -> Params:
        photos = adaptive_avg_pool2d(photos, self.encoder_size or photos.shape[-1])
        parameters = self.encoder(reader, photos)
        return parameters | {"z": parameters["z"] / self.network.gain, "flash": parameters["flash"] / self.network.gain}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """The same materials turned, mirrored, mixed and recoloured, photographed anew."""
        size = (self.network.height, self.network.width)
        fine = varied(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photo = adaptive_avg_pool2d(photographs(fine, rng), size)
        return tasks.variants({"photo": photo} | self.described(pooled(fine, size)))

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """`error` under lights that no fit has seen, and how far the maps are off.

        `normal` in degrees, `diffuse`, `roughness`, `specular` as means of differences, colours at gamma 2.2; `relief`,
        how steep normals are on average over how steep they should be; `blots`, the difference of diffuse colours where
        the photo clips, 0 if it does not.
        """
        return self.errors_of(self.final_maps(theta, tasks.data["photo"][tasks.rows]), tasks)

    def errors_of(self, answer: Maps, tasks: Tasks) -> dict[str, Tensor]:
        """Of maps [T, C, H, W] of the field's size."""
        if "maps" not in tasks.data:
            return {}
        maps, target = answer, unpack(tasks.data["maps"][tasks.rows])
        logs, references = self.judged(maps), self.judged(target)
        cosine = (maps.normal * target.normal).sum(1).clamp(-1, 1)
        parts = dict(zip(("diffuse", "specular", "roughness"), differences(maps, target), strict=False))
        steep = [statistics(each)[:, 0, -1] + LEVEL_SINE for each in (maps, target)]
        photo = tasks.data["photo"][tasks.rows]
        return {
            "error": (logs - references).abs().mean((1, 2, 3, 4)),
            "normal": torch.rad2deg(cosine.acos()).mean((1, 2)),
            "relief": steep[0] / steep[1],
            "blots": blots(parts["diffuse"], photo),
            **{name: part.abs().mean((1, 2, 3)) for name, part in parts.items()},
        }

    def judged(self, maps: Maps) -> Tensor:
        """Logs of the radiance of maps [T, ...] under JUDGED lights, [T, V, 3, H, W]."""
        return self._logs(maps, _pairs(JUDGED).to(maps.diffuse)[None])

    def fine_maps(self, theta: Params, photo: Tensor) -> Maps:
        """The maps [T, C, H, W] that fields make of linear photographs [T, 3, H, W], at these photographs' size.

        Made by rows: a layer of a field of 2048 x 2048 texels takes 0.5 GB.
        """
        field = self.network._replace(height=photo.shape[-2], width=photo.shape[-1])
        parts = [self.maps_from(rows) for rows in field_by_rows(field, theta, inputs_of(photo))]
        return Maps(*(torch.cat(part, -2) for part in zip(*parts, strict=True)))

    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        """The flash of each photograph that a fit saw, without task axis, as the fit places it."""
        flash = flash_of(self.network.gain * theta["flash"][None])
        return [Flash(flash.place[0], flash.gain[0], flash.eye)]


def photo_loss(seen: Tensor, photos: Tensor, learned: Params) -> Tensor:
    """Mean difference of logs, [T], of radiance and photographs [T, ...]; of clipped px only darker values count."""
    short = (photos + RADIANCE_FLOOR).log() - (seen + RADIANCE_FLOOR).log()
    short = torch.where(photos > CLIPPED_VALUE, relu(short), short)
    return norm(short, learned).mean(tuple(range(1, short.ndim)))


def _map_loss(apart: list[Tensor], learned: Params) -> Tensor:
    """Sum of the mean differences of maps, as of `differences`, [T]; colours as the eye spaces them."""
    return torch.stack([norm(each, learned).mean((1, 2, 3)) for each in apart]).sum(0)


def _steepness(maps: Maps) -> Tensor:
    """Sines of the angles between normals and the patch's, means in cells and a little more, [T, 1, 8, 8]."""
    return adaptive_avg_pool2d(tilt(maps.normal), STEEP_CELLS) + 2 * LEVEL_SINE


def blots(diffuse: Tensor, photo: Tensor) -> Tensor:
    """Mean of how far diffuse colours are off, as of `differences`, where the photo clips; 0 where it does not, [T]."""
    clips = (photo > CLIPPED_VALUE).any(1, keepdim=True).float()
    return (diffuse.abs() * clips).mean((1, 2, 3)) / clips.mean((1, 2, 3)).clamp_min(1e-6)


def draw_pairs(counts: tuple[int, int], rng: Generator, tasks: int) -> Tensor:
    """Places of light and viewer [tasks, V, 2, 3]: some anywhere, then some that mirror each other in the patch."""
    return torch.cat([oblique_pairs(rng, (tasks, counts[0])), mirroring_pairs(rng, (tasks, counts[1]))], 1)


def _pairs(counts: tuple[int, int]) -> Tensor:
    """The same ones for all tasks and for ever, [V, 2, 3]."""
    return draw_pairs(counts, Generator().manual_seed(sum(counts)), 1)[0]

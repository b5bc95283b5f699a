"""Illumination: HDR environment maps, from themselves or from an LDR photograph of a sphere (paper section 4.1.5)."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, relu, softmax

from metapp.appearance.latlong import resample_maps, solid_angles, sphere_normals, texel_directions
from metapp.appearance.photograph import (
    CameraCurves,
    SphereMaterials,
    develop,
    photograph_spheres,
    render_material_spheres,
)
from metapp.apps.illumination import ball_encoder
from metapp.apps.illumination.map_augmentation import normalise_luminance, vary_maps
from metapp.apps.illumination.mirror import complete_maps, mirror_loss, resample_seen, shows_mirror
from metapp.apps.illumination.spheres import (
    FACING_SURFACES,
    MIRRORING_SURFACES,
    SPHERE_NAMES,
    sphere_errors,
    surface_transfer,
)
from metapp.apps.illumination.suns import add_suns, find_suns, join_suns, split_suns
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import CodedApp, smooth_absolute
from metapp.rendering.second_scene import relighting

RADIANCE_FLOOR = 0.01  # of a map of mean luminance 1: the log of radiance is flat below
RADIOSITY_FLOOR = 0.02  # the same for what surfaces send out
# weights in the outer loss, beside what faces the light: of texels, what mirrors, the log of both, the photograph
TEXELS_WEIGHT, MIRRORING_WEIGHT, LOGS_WEIGHT, PHOTO_WEIGHT = 0.3, 0.3, 0.2, 0.3
LIGHT_WEIGHT = 0.3  # by how much a texel's own light adds to what it counts in a fit, so that few steps find suns
BODY_NUMBERS = 10  # numbers of a sphere's material and a camera
BODY_GAIN = 100  # of these: few steps at a network's rate find them, else the map takes their part
BODY_ROUGHNESSES = (0.25, 0.42, 0.7)
DEFAULT_READ_ROWS = 64  # of a map that every size can be made of, but for finer ones
LOSS_PHOTO_PX = 32  # side of the photograph in the loss


@dataclass(frozen=True)
class Illumination(CodedApp):
    """One environment map a task, of mean luminance 1.

    Under the protocol "reference" a fit sees the map itself; under "photo" it sees the LDR photograph of a sphere
    alone, and is the light by which a sphere of some material looks so through some camera. If that sphere is a
    mirror, the task may hold the light in it (`metapp.apps.illumination.mirror`): a fit is then the rest of the map.

    Attributes:
        encoder_size: rows and columns of the code that the encoder reads.
    """

    encoder_size: tuple[int, int] = (16, 32)

    name = "illumination"
    error_measure = ErrorMeasure(
        "mean absolute error of a second scene's picture under the map",
        scale=100,
        further={
            f"{name}_{kind}": f"{name} sphere, {title}"
            for kind, title in (("rmse", "si-RMSE"), ("angle", "degrees"))
            for name in SPHERE_NAMES
        },
    )
    tensors: ClassVar = {
        "photos": TensorSpec(("K", 3, 64, 64), "uint8"),
        "map": TensorSpec((3, "H", "W"), low=0.0, optional=True),
        "scale": TensorSpec((), low=0.0, optional=True),
        "seen": TensorSpec((3, "h", "w"), low=0.0, optional=True),
        "certain": TensorSpec((2, "h", "w"), low=0.0, high=1.0, optional=True),
    }

    @property
    def read_size(self) -> int:
        return self.network.height if self.network.height > DEFAULT_READ_ROWS else 0

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """`photo` uint8 [3, S, S], and of the map `map` [3, H, W] and `sent`, the radiosity of surfaces under it.

        Of a mirror `seen` [3, H, W] and `certain` [2, H, W], if fits see a photograph.
        """
        relighting.transfer_matrix()  # better missed now than after a fit
        photo = {"photo": task.data["photos"][0]} | self.mirrored(task)
        if "map" in task.data:
            described = self.described(task.data["map"][None].float())
            return photo | {key: value[0] for key, value in described.items()}
        if self.protocol == "reference":
            raise ValueError(
                f"{task.name}: a photo, expected an HDR map, .exr or .hdr; leave --observe reference out if it shows a "
                "ball; of a surface take texture or an svBRDF."
            )
        return photo

    def mirrored(self, task: Task) -> dict[str, Tensor]:
        """The light in a task's mirror, `seen` [3, H, W] and `certain` [2, H, W]; {} if fits see the map."""
        height, width = self.network.height, self.network.width
        if self.protocol != "photo":
            return {}
        if not {"seen", "certain"} <= task.data.keys():
            return {"seen": torch.zeros(3, height, width), "certain": torch.zeros(2, height, width)}
        return resample_seen(task.data["seen"].float(), task.data["certain"].float(), height, width)

    def described(self, maps: Tensor) -> dict[str, Tensor]:
        maps = resample_maps(maps, self.network.height, self.network.width)
        suns = {"suns": find_suns(maps)} if self.protocol == "reference" else {}
        return {"map": maps, "sent": maps.flatten(2) @ self._surfaces(maps).T} | suns

    def _surfaces(self, like: Tensor) -> Tensor:
        """Transport of light to surfaces, [S, H * W]: diffuse ones that face, glossy ones that mirror all around."""
        return surface_transfer(self.network.height, self.network.width, like.device).to(like)

    def init(self, rng: Generator, count: int) -> Params:
        return super().init(rng, count) | {"body": torch.zeros(count, BODY_NUMBERS, device=rng.device)}

    def radiance_of(self, theta: Params) -> Tensor:
        """The fitted maps, linear radiance [T, 3, H, W]."""
        field, z = self.network, theta["z"]
        towards = texel_directions(field.height, field.width, dtype=z.dtype, device=z.device)
        maps = field(theta, towards.expand(len(z), -1, -1, -1)).clamp_max(16).exp()
        return add_suns(maps, join_suns(theta)) if "suns.light" in theta else maps

    def task_parameters(self, tasks: Tasks) -> Params:
        """The suns, if fits see the map."""
        return split_suns(tasks.data["suns"][tasks.rows]) if "suns" in tasks.data else {}

    def sized(self, height: int, width: int) -> Illumination:
        """The application with maps of another size: its networks can be evaluated anywhere."""
        return replace(self, network=self.network._replace(height=height, width=width))

    def answer(self, theta: Params, data: Batch) -> Tensor:
        """The same as they are judged and shown, of mean luminance 1; `data` as of `prepare`, [T, ...]."""
        maps = self.radiance_of(theta)
        return normalise_luminance(complete_maps(maps, data) if "seen" in data else maps)

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the photograph, or of the map, [T]: of log radiance, the radiosity of surfaces, and its log."""
        maps = self.radiance_of(theta)
        if self.protocol == "photo":
            return self._visible_loss(theta, maps, batch, learned)
        light = torch.exp(learned["light"])[:, None, None, None] if learned else LIGHT_WEIGHT
        sent, logs = self._sent_apart(maps, batch["sent"], learned)
        return _texels(maps, batch["map"], learned, light) + (sent + logs).mean((1, 2))

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the map, whatever fits see, [T]: above all of the radiosity of diffuse surfaces under it."""
        maps, scaled = self.radiance_of(theta), self.answer(theta, batch)
        sent, logs = self._sent_apart(scaled, batch["sent"], {})
        texels = _texels(scaled, batch["map"], {}, 0.0)
        photo = self._visible_loss(theta, maps, batch, {})
        faced, mirrored = (each.mean((1, 2)) for each in sent.split((FACING_SURFACES, MIRRORING_SURFACES), 2))
        result: Tensor = (
            faced
            + MIRRORING_WEIGHT * mirrored
            + LOGS_WEIGHT * logs.mean((1, 2))
            + TEXELS_WEIGHT * texels
            + PHOTO_WEIGHT * photo
        )
        return result

    def _sent_apart(self, maps: Tensor, target: Tensor, learned: Params) -> tuple[Tensor, Tensor]:
        """Differences of the radiosity of surfaces from the target, and of its log, [T, 3, S] each."""
        sent = maps.flatten(2) @ self._surfaces(maps).T
        return smooth_absolute(sent - target, learned), smooth_absolute(
            (sent + RADIOSITY_FLOOR).log() - (target + RADIOSITY_FLOOR).log(), learned
        )

    def _visible_loss(self, theta: Params, maps: Tensor, batch: Batch, learned: Params) -> Tensor:
        """Of the light in the mirror, else of the photograph, [T]."""
        of_photo = self._photo_loss(theta, maps, batch, learned)
        return (
            torch.where(shows_mirror(batch), mirror_loss(maps, batch, learned), of_photo)
            if "seen" in batch
            else of_photo
        )

    def _photo_loss(self, theta: Params, maps: Tensor, batch: Batch, learned: Params) -> Tensor:
        """Mean difference of display values; where the photograph clips, only darker values count."""
        side = batch["photo"].shape[-1]
        target = avg_pool2d(batch["photo"].to(maps) / 255, side // LOSS_PHOTO_PX)
        short = target - self.ball(theta, maps, LOSS_PHOTO_PX)
        short = torch.where(target > 0.98, relu(short), short)
        return smooth_absolute(short, learned).flatten(2)[..., _inside(side, maps.device)].mean((1, 2))

    def ball(self, theta: Params, maps: Tensor, size: int) -> Tensor:
        """The photograph [T, 3, size, size] of the fitted sphere under maps of `radiance_of`, as of `develop`."""
        material, camera = decode_body(BODY_GAIN * theta["body"])
        return develop(render_material_spheres(maps, material, size, BODY_ROUGHNESSES), camera)

    def loss_parameters(self, steps: int) -> Params:
        light = {"light": torch.full((steps,), math.log(LIGHT_WEIGHT))} if self.protocol == "reference" else {}
        return super().loss_parameters(steps) | light

    def init_reader(self, rng: Generator) -> Params:
        return ball_encoder.init_reader(rng, self.network.code, BODY_NUMBERS)

    def read(self, reader: Params, photos: Tensor) -> Params:
        code, body = ball_encoder.read_ball_photos(
            reader, photos.to(next(iter(reader.values()))) / 255, *self.encoder_size
        )
        return {"z": code / self.network.gain, "body": body / BODY_GAIN}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Augmented maps, and new photographs of spheres under them."""
        maps = vary_maps(tasks.data["map"][tasks.rows], rng)
        photos = (photograph_spheres(maps, rng, tasks.data["photo"].shape[-1]) * 255).round().to(torch.uint8)
        return tasks.make_variants({"photo": photos} | self.described(maps))

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Of the second scene's pictures `error`; `map`, of the maps' logs; and `spheres.sphere_errors`."""
        return self.errors_of(self.answer(theta, {key: value[tasks.rows] for key, value in tasks.data.items()}), tasks)

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of maps [T, 3, H, W] of the field's size, linear radiance."""
        if "map" not in tasks.data:
            return {}
        maps, target = normalise_luminance(answer), tasks.data["map"][tasks.rows]
        error = (relighting.relight(maps) - relighting.relight(target)).abs().mean((1, 2, 3))
        return {"error": error, "map": _texels(maps, target, {}, 0.0), **sphere_errors(maps, target)}


def _texels(maps: Tensor, target: Tensor, learned: Params, light: Tensor | float) -> Tensor:
    """Mean difference of the logs of radiance, [T].

    Texels count by their solid angle, and by the target's light, of mean 1, `light` times as much.
    """
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    weights = weights * (1 + light * target.mean(1, keepdim=True))
    off = smooth_absolute((maps + RADIANCE_FLOOR).log() - (target + RADIANCE_FLOOR).log(), learned)
    return (off * weights).sum((2, 3)).mean(1)


def decode_body(body: Tensor) -> tuple[SphereMaterials, CameraCurves]:
    """Materials and cameras of their description [T, BODY], any numbers."""
    material = SphereMaterials(torch.sigmoid(body[:, :3] + 1), torch.sigmoid(body[:, 3] - 1), softmax(body[:, 4:7], 1))
    return material, CameraCurves(torch.exp(body[:, 7]), torch.exp(0.3 * body[:, 8]), 0.5 * torch.sigmoid(body[:, 9]))


@functools.lru_cache(maxsize=4)
def _inside(side: int, device: torch.device) -> Tensor:
    """Where, row by row, the pixels are of LOSS_PX px a side of a photograph that show nothing but the sphere."""
    inner = avg_pool2d(sphere_normals(side)[1].float()[None], side // LOSS_PHOTO_PX)[0] > 0.999
    return inner.flatten().nonzero()[:, 0].to(device)

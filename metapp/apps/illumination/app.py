"""The application of illumination: HDR environment maps (paper section 4.1.5).

A fit sees a map itself, or nothing but the LDR photograph of a sphere under it. Either way its prediction is a map,
which is judged by what it lights. Other modules compute how light gets to spheres and to the second scene, two spheres
on a floor.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, relu, softmax
from typing_extensions import override

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
from metapp.apps.illumination.mirror import (
    CLIPPED_DISPLAY_VALUE,
    complete_maps,
    mirror_loss,
    resample_seen,
    shows_mirror,
)
from metapp.apps.illumination.spheres import (
    FACING_SURFACES,
    MIRRORING_SURFACES,
    SPHERE_NAMES,
    sphere_errors,
    surface_transfer,
)
from metapp.apps.illumination.suns import SUN_SPECS, add_suns, find_suns, join_suns, split_suns
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import CodedApp, smooth_absolute
from metapp.rendering.second_scene import relighting

RADIANCE_FLOOR = 0.01  # radiance in a map of mean luminance 1, below which its log is flat
REFLECTED_RADIANCE_FLOOR = 0.02  # radiance that a white surface reflects under such a map, below which its log is flat
# Weights of terms of the outer loss, in which the radiance that diffuse surfaces reflect has weight 1
TEXELS_WEIGHT = 0.3  # of the log radiance of texels
GLOSSY_WEIGHT = 0.3  # of the radiance that glossy surfaces reflect
LOGS_WEIGHT = 0.2  # of the log radiance that all surfaces reflect
PHOTO_WEIGHT = 0.3  # of the photograph
# A texel's weight in the inner loss is its solid angle times (1 + LIGHT_WEIGHT * radiance), where radiance is 1 on
# average: bright texels count more, so that few steps find suns.
LIGHT_WEIGHT = 0.3
BALL_AND_CAMERA_NUMBERS = 10  # numbers that describe a sphere's material and a camera
BALL_AND_CAMERA_GAIN = (
    100  # factor of these numbers, so that few steps at a network's rate find them; else the map would absorb them
)
BALL_ROUGHNESSES = (0.25, 0.42, 0.7)  # roughnesses of the lobes that a sphere's gloss is mixed of
DEFAULT_READ_ROWS = 64  # rows to which readers resample files of maps unless they are given another number
LOSS_PHOTO_PX = 32  # side of the photograph in the loss


@dataclass(frozen=True)
class Illumination(CodedApp):
    """The application of illumination: a task is one environment map of mean luminance 1.

    :class:`FromMap` has fits that see the map itself, :class:`FromBall` fits of a photograph.

    Attributes:
        encoder_size: rows and columns of the code that General's encoder predicts.
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
    @override
    def read_size(self) -> int:
        """The number of rows to which maps are read: the network's if it has more than DEFAULT_READ_ROWS.

        For other networks it is 0, so that readers take their default, DEFAULT_READ_ROWS rows.
        """
        return self.network.height if self.network.height > DEFAULT_READ_ROWS else 0

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare the photograph, and the map if it is known.

        Returns:
            `photo` uint8 [3, S, S]; the tensors of :meth:`prepare_mirror`; and, if the map is known, the tensors of
            :meth:`describe_maps` without a task axis.
        """
        relighting.transfer_matrix()  # errors need it: if it cannot be made, that shows before the fit
        prepared = {"photo": task.data["photos"][0]} | self.prepare_mirror(task)
        if "map" in task.data:
            tensors = self.describe_maps(task.data["map"][None].float())
            return prepared | {key: value[0] for key, value in tensors.items()}
        return prepared

    def prepare_mirror(self, task: Task) -> dict[str, Tensor]:
        """Return the light in the mirror ball of a task's photograph, at the size of the network; {} if fits see none.

        Returns:
            `seen`, the linear radiance of the texels that the ball mirrors, [3, H, W]; and `certain` [2, H, W] in
            [0, 1]: the share of each texel that is seen, and the share that is seen but clips in all photographs of
            the ball, so that `seen` is a lower bound of its radiance.
        """
        return {}

    def describe_maps(self, maps: Tensor) -> dict[str, Tensor]:
        """Resample maps to the network's size, and compute the quantities that losses compare with fits.

        Args:
            maps: linear radiance [T, 3, h, w], of any size.

        Returns:
            `map`, the radiance maps [T, 3, H, W]; and `reflected`, the radiance that S surfaces reflect under each map,
            [T, 3, S], see :meth:`_reflected_radiance`.
        """
        maps = resample_maps(maps, self.network.height, self.network.width)
        return {"map": maps, "reflected": self._reflected_radiance(maps)}

    def _reflected_radiance(self, maps: Tensor) -> Tensor:
        """Return the radiance [T, 3, S] that S white surfaces reflect under radiance maps [T, 3, H, W].

        First come FACING_SURFACES diffuse surfaces, whose normals are spread evenly over all directions. Then come
        MIRRORING_SURFACES glossy surfaces, which are rough; the directions around which they gather light for a viewer
        at +z are spread evenly, too.
        """
        transfer = surface_transfer(self.network.height, self.network.width, maps.device).to(maps)
        return maps.flatten(2) @ transfer.T

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return super().init(rng, count) | {"body": torch.zeros(count, BALL_AND_CAMERA_NUMBERS, device=rng.device)}

    def radiance_maps(self, theta: Params) -> Tensor:
        """Return the maps that the network computes, with the suns among a fit's parameters, if there are any, added.

        They are linear radiance [T, 3, H, W]; neither is their luminance normalised, nor is the light in a mirror
        filled in, as in :meth:`prediction`.
        """
        network, z = self.network, theta["z"]
        directions = texel_directions(network.height, network.width, dtype=z.dtype, device=z.device)
        maps = network(theta, directions.expand(len(z), -1, -1, -1)).clamp_max(16).exp()
        return add_suns(maps, join_suns(theta)) if "suns.light" in theta else maps

    def resize(self, height: int, width: int) -> Illumination:
        """Return the application with maps of another size, at which its network can be evaluated, too."""
        return replace(self, network=self.network._replace(height=height, width=width))

    def prediction(self, theta: Params, data: Batch) -> Tensor:
        """Return the radiance maps [T, 3, H, W] that errors and pictures use, of mean luminance 1.

        Where a task's photograph shows a mirror, the directions that are seen in it get the radiance seen there.

        Args:
            theta: fits [T, ...].
            data: tensors of :meth:`prepare`, with a task axis.
        """
        maps = self.radiance_maps(theta)
        return normalise_luminance(complete_maps(maps, data) if "seen" in data else maps)

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the true map and from the photograph, [T].

        It is a weighted sum: the radiance that diffuse surfaces reflect has weight 1, what glossy ones reflect
        GLOSSY_WEIGHT, the logs of both LOGS_WEIGHT, the log radiance of texels TEXELS_WEIGHT and the photograph
        PHOTO_WEIGHT. All terms but the last are of the maps that :meth:`prediction` returns.
        """
        maps, predictions = self.radiance_maps(theta), self.prediction(theta, batch)
        differences, log_differences = self._compare_reflected_radiance(predictions, batch["reflected"], {})
        texel_loss = _texel_loss(predictions, batch["map"], {}, 0.0)
        # The photograph is compared with the maps as they are fitted: predictions hold light seen in the mirror, and
        # their luminance is normalised, though the fitted camera's exposure belongs to the unit of the fitted maps.
        photo_loss = self._photo_loss(theta, maps, batch, {})
        diffuse_loss, glossy_loss = (
            part.mean((1, 2)) for part in differences.split((FACING_SURFACES, MIRRORING_SURFACES), 2)
        )
        result: Tensor = (
            diffuse_loss
            + GLOSSY_WEIGHT * glossy_loss
            + LOGS_WEIGHT * log_differences.mean((1, 2))
            + TEXELS_WEIGHT * texel_loss
            + PHOTO_WEIGHT * photo_loss
        )
        return result

    def _compare_reflected_radiance(
        self, maps: Tensor, target: Tensor, loss_parameters: Params
    ) -> tuple[Tensor, Tensor]:
        """Compare the radiance that S surfaces reflect under maps with a target.

        Args:
            maps: linear radiance [T, 3, H, W].
            target: the radiance that the surfaces reflect under the true maps, [T, 3, S].
            loss_parameters: the values that a rule has learned; {} for none.

        Returns:
            Absolute differences of the radiance and of its log, [T, 3, S] each; see :func:`smooth_absolute`.
        """
        reflected = self._reflected_radiance(maps)
        log_difference = (reflected + REFLECTED_RADIANCE_FLOOR).log() - (target + REFLECTED_RADIANCE_FLOOR).log()
        return smooth_absolute(reflected - target, loss_parameters), smooth_absolute(log_difference, loss_parameters)

    def _photo_loss(self, theta: Params, maps: Tensor, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the photograph of its task, [T].

        For a task whose photograph shows a mirror, the fitted map is compared with the light in the mirror. For every
        other task a photograph is rendered from the fitted map, sphere and camera, and display values are compared.
        Without `seen` in the batch, as of fits of maps and of augmented tasks, all photographs are rendered.

        Args:
            theta: fits [T, ...].
            maps: maps of :meth:`radiance_maps`, [T, 3, H, W].
            batch: tensors of :meth:`prepare`, with a task axis.
            loss_parameters: the values that a rule has learned; {} for none.
        """
        display_loss = self._display_loss(theta, maps, batch, loss_parameters)
        if "seen" not in batch:
            return display_loss
        return torch.where(shows_mirror(batch), mirror_loss(maps, batch, loss_parameters), display_loss)

    def _display_loss(self, theta: Params, maps: Tensor, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the mean difference of rendered photographs from photographs in display values, [T].

        Where a photograph clips, it is a lower bound: only darker renderings differ from it.
        """
        side = batch["photo"].shape[-1]
        target = avg_pool2d(batch["photo"].to(maps) / 255, side // LOSS_PHOTO_PX)
        shortfall = target - self.render_ball(theta, maps, LOSS_PHOTO_PX)
        shortfall = torch.where(target > CLIPPED_DISPLAY_VALUE, relu(shortfall), shortfall)
        differences = smooth_absolute(shortfall, loss_parameters).flatten(2)
        return differences[..., _find_inner_pixels(side, maps.device)].mean((1, 2))

    def render_ball(self, theta: Params, maps: Tensor, size: int) -> Tensor:
        """Return the photograph of the fitted sphere through the fitted camera, display values [T, 3, size, size].

        Args:
            theta: fits [T, ...].
            maps: maps of :meth:`radiance_maps`, [T, 3, H, W].
            size: the photograph's side in px.
        """
        material, camera = decode_ball_and_camera(BALL_AND_CAMERA_GAIN * theta["body"])
        return develop(render_material_spheres(maps, material, size, BALL_ROUGHNESSES), camera)

    @override
    def init_reader(self, rng: Generator) -> Params:
        return ball_encoder.init_reader(rng, self.network.code, BALL_AND_CAMERA_NUMBERS)

    @override
    def read(self, reader: Params, photos: Tensor) -> Params:
        code, numbers = ball_encoder.read_ball_photos(
            reader, photos.to(next(iter(reader.values()))) / 255, *self.encoder_size
        )
        # The network multiplies z by its gain, and `render_ball` multiplies these numbers by BALL_AND_CAMERA_GAIN: so
        # the encoder predicts code and numbers as they are used.
        return {"z": code / self.network.gain, "body": numbers / BALL_AND_CAMERA_GAIN}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return augmented maps, and new photographs of spheres under them."""
        maps = vary_maps(tasks.data["map"][tasks.rows], rng)
        photos = (photograph_spheres(maps, rng, tasks.data["photo"].shape[-1]) * 255).round().to(torch.uint8)
        return tasks.make_variants({"photo": photos} | self.describe_maps(maps))

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        data = {key: value[tasks.rows] for key, value in tasks.data.items()}
        return self.errors_of(self.prediction(theta, data), tasks)

    def errors_of(self, prediction: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure how far maps are off; {} if the true ones are not known.

        Args:
            prediction: linear radiance [T, 3, H, W] at any scale, of the size of the network's maps.
            tasks: T tasks.

        Returns:
            `error`, the mean absolute difference of the second scene's pictures; `map`, the mean difference of log
            radiance; and errors of three spheres under the maps: see :func:`sphere_errors`. Each is [T].
        """
        if "map" not in tasks.data:
            return {}
        maps, target = normalise_luminance(prediction), tasks.data["map"][tasks.rows]
        error = (relighting.relight(maps) - relighting.relight(target)).abs().mean((1, 2, 3))
        return {"error": error, "map": _texel_loss(maps, target, {}, 0.0), **sphere_errors(maps, target)}


@dataclass(frozen=True)
class FromMap(Illumination):
    """The application whose fits see the map itself, and its brightest small lights (--observe reference)."""

    observes = "reference"

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare the photograph and the map. Raises ValueError if the task has no map."""
        if "map" not in task.data:
            raise ValueError(
                f"{task.name}: a photo, expected an HDR map, .exr or .hdr; leave --observe reference out if it shows a "
                "ball; if it shows a surface, take the application texture, svbrdf_stationary or svbrdf_nonstationary."
            )
        return super().prepare(task)

    @override
    def describe_maps(self, maps: Tensor) -> dict[str, Tensor]:
        """Add `suns`, the brightest small lights of each map, [T, SUN_COUNT, SUN_NUMBERS]."""
        described = super().describe_maps(maps)
        return described | {"suns": find_suns(described["map"])}

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return the suns of the true maps, found in closed form, which steps leave as they are."""
        return split_suns(tasks.data["suns"][tasks.rows]) if "suns" in tasks.data else {}

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        return SUN_SPECS

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the map, [T].

        It has three terms: the log radiance of texels, the radiance that surfaces reflect, and the log of that
        radiance.

        Args:
            theta: fits [T, ...].
            batch: what fits see, from :meth:`sample`.
            loss_parameters: values that a rule has learned; {} for none. `light` [T] is the log of a weight that
                replaces LIGHT_WEIGHT; for `smoothing` see :func:`smooth_absolute`.
        """
        maps = self.radiance_maps(theta)
        light_weight = torch.exp(loss_parameters["light"])[:, None, None, None] if loss_parameters else LIGHT_WEIGHT
        differences, log_differences = self._compare_reflected_radiance(maps, batch["reflected"], loss_parameters)
        reflected_loss = (differences + log_differences).mean((1, 2))
        return _texel_loss(maps, batch["map"], loss_parameters, light_weight) + reflected_loss

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return super().initial_loss_parameters(steps) | {"light": torch.full((steps,), math.log(LIGHT_WEIGHT))}


@dataclass(frozen=True)
class FromBall(Illumination):
    """The application whose fits see the LDR photograph of a sphere alone (--observe photo).

    They find the light under which a sphere of some material looks so through some camera. If that sphere is a mirror,
    the task may hold the light in it (`metapp.apps.illumination.mirror`), and a fit adds the rest of the map.
    """

    observes = "photo"

    @override
    def prepare_mirror(self, task: Task) -> dict[str, Tensor]:
        """Return zeros for a task without light in a mirror, such as one whose photograph shows another sphere."""
        height, width = self.network.height, self.network.width
        if not {"seen", "certain"} <= task.data.keys():
            return {"seen": torch.zeros(3, height, width), "certain": torch.zeros(2, height, width)}
        return resample_seen(task.data["seen"].float(), task.data["certain"].float(), height, width)

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of each fit from the photograph, [T]."""
        return self._photo_loss(theta, self.radiance_maps(theta), batch, loss_parameters)


def _texel_loss(maps: Tensor, target: Tensor, loss_parameters: Params, light_weight: Tensor | float) -> Tensor:
    """Return the mean difference of the logs of radiance, [T].

    A texel counts by its solid angle, times 1 + `light_weight` times the target's radiance there, which is 1 on
    average.

    Args:
        maps: linear radiance [T, 3, H, W].
        target: true maps [T, 3, H, W], of mean luminance 1.
        loss_parameters: the values that a rule has learned; {} for none.
        light_weight: what the target's radiance adds to a texel's weight, a number or [T, 1, 1, 1].
    """
    weights = solid_angles(*maps.shape[-2:], dtype=maps.dtype, device=maps.device) / (4 * math.pi)
    weights = weights * (1 + light_weight * target.mean(1, keepdim=True))
    differences = smooth_absolute((maps + RADIANCE_FLOOR).log() - (target + RADIANCE_FLOOR).log(), loss_parameters)
    return (differences * weights).sum((2, 3)).mean(1)


def decode_ball_and_camera(numbers: Tensor) -> tuple[SphereMaterials, CameraCurves]:
    """Return the materials of balls, and the cameras, that unbounded numbers [T, BALL_AND_CAMERA_NUMBERS] describe."""
    material = SphereMaterials(
        torch.sigmoid(numbers[:, :3] + 1), torch.sigmoid(numbers[:, 3] - 1), softmax(numbers[:, 4:7], 1)
    )
    return material, CameraCurves(
        torch.exp(numbers[:, 7]), torch.exp(0.3 * numbers[:, 8]), 0.5 * torch.sigmoid(numbers[:, 9])
    )


@functools.lru_cache(maxsize=4)
def _find_inner_pixels(side: int, device: torch.device) -> Tensor:
    """Find the pixels of a reduced photograph, LOSS_PHOTO_PX a side, that lie wholly inside the sphere's outline.

    Args:
        side: side in px of the photograph before it is reduced.
        device: device of the indices.

    Returns:
        Their indices [P] into all pixels of the reduced photograph, which are counted row by row from the top.
    """
    is_inside = avg_pool2d(sphere_normals(side)[1].float()[None], side // LOSS_PHOTO_PX)[0] > 0.999
    return is_inside.flatten().nonzero()[:, 0].to(device)

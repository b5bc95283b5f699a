"""Stationary svBRDFs of pieces of the flash photograph: maps that a network makes of a quilt that tiles.

Diffuse colour is the quilt's but for what the network changes, and relief and gloss follow it, so that a stitch of a
knit stays a stitch in each map. The quilt is fetched from the photograph at the photograph's own resolution.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import DISPLAY_GAMMA
from metapp.appearance.features import detail_difference, detail_statistics
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.highlight import remove_shading
from metapp.appearance.lattice import remove_quadratic_trend
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.exemplar.app import PictureChanges, move_tiles, turn_picture
from metapp.apps.exemplar.quilted_app import QuiltedExemplarApp
from metapp.apps.svbrdf_stationary.flash_statistics import LEAST_ROUGHNESS, chroma_deviations
from metapp.apps.svbrdf_stationary.gloss_prior import SvbrdfNearPrior
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.generators import Pyramid
from metapp.networks.quilted import enlarge_grid, fetch_pieces, normalise_quilts, quilt_deviation

DISPLAY_RANGE = (0.02, 0.98)  # display values to which quilts are clamped before logits, which are unbounded
COLOUR_WEIGHT = 3.0  # weight in the loss of the difference of standard deviations of chroma from the photo's
SOFTNESS_WEIGHT = 0.2  # weight in the loss of the difference of the finest detail from the exemplar's
MAP_WEIGHT = 3.0  # weight in the outer loss of the differences from the true maps
# Weights in that difference of diffuse colour, specular reflectance, roughness, slopes, and squared slopes
PART_WEIGHTS = (1.0, 1.0, 1.0, 2.0, 8.0)
# Rows and columns of cells whose means of the network's output are made equal: a stationary material has no slow
# changes, and a network that reads normalised quilts makes clouds of what is left of the light
SLOW_CELLS = 8
LINE_WINDOW_PX = 9  # side of windows, odd, in which a photograph is compared with the photograph in even light
LINE_DEVIATION = 0.005  # standard deviation of display values below which a window counts as flat
# Numbers of channels of what is quilted again: diffuse display values, specular reflectance, roughness and height
LAYER_CHANNELS = (3, 1, 1, 1)


@dataclass(frozen=True)
class QuiltedSvbrdf(QuiltedExemplarApp, SvbrdfNearPrior):
    """Stationary svBRDFs whose maps a network makes of a quilt of the flash photograph.

    A training task may hold `maps` [10, M, M], the true maps over the photograph at its exposure, packed by
    :func:`metapp.appearance.svbrdf_maps.pack_maps`: the outer loss then compares each texel.

    Attributes:
        network: the generator, which reads quilts.
    """

    network: Pyramid = field()

    tensors: ClassVar = SvbrdfNearPrior.tensors | {"maps": TensorSpec((10, "M", "M"), low=-1, high=1, optional=True)}

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add the true maps over the photograph, `maps` [10, M, M], if the task has them."""
        data = super().prepare(task)
        return data | ({"maps": task.data["maps"].float()} if "maps" in task.data else {})

    @override
    def make_targets(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Add `detail` [B, 3, N], how fine the detail of photographs is; see :func:`detail_statistics`."""
        return super().make_targets(exemplars, octave) | {"detail": detail_statistics(exemplars)}

    @override
    def change_data(self, tasks: Tasks, changes: PictureChanges) -> dict[str, Tensor]:
        data = super().change_data(tasks, changes)
        if "maps" not in tasks.data:
            return data
        pairs = zip(tasks.data["maps"][tasks.rows], *changes, strict=True)
        return data | {"maps": torch.stack([turn_maps(maps, *change) for maps, *change in pairs])}

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add `detail` [T, 3, N], how fine the detail of the photographs is."""
        return super().sample(tasks, rng, count) | tasks.gather(("detail",))

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add the true maps at the places of the quilts, `maps` [T, 10, H, W], if the tasks have them."""
        batch = super().outer_sample(tasks, rng, count)
        if "maps" not in tasks.data:
            return batch
        places = zip(tasks.data["maps"][tasks.rows], tasks.data["places"][tasks.rows], strict=True)
        size = self.octaves.octave_size()
        return batch | {"maps": torch.stack([fetch_pieces(maps, place, size, self.cells) for maps, place in places])}

    @override
    def map_loss(self, maps: Maps, batch: Batch) -> Tensor:
        """Add the difference from the true maps texel by texel, if the batch has them."""
        loss = super().map_loss(maps, batch)
        if "maps" not in batch:
            return loss
        true_maps = unpack_maps(move_tiles(batch["maps"], batch["noise"]))
        slope_differences = (maps.normal - true_maps.normal)[:, :, :2]
        differences = (
            _display(maps.diffuse) - _display(true_maps.diffuse),
            _display(maps.specular) - _display(true_maps.specular.mean(2, keepdim=True)),
            maps.roughness - true_maps.roughness,
            slope_differences,
            slope_differences.square(),
        )
        pairs = zip(differences, PART_WEIGHTS, strict=True)
        return loss + MAP_WEIGHT * torch.stack(
            [weight * difference.abs().mean((1, 2, 3, 4)) for difference, weight in pairs]
        ).sum(0)

    @override
    def compare_pictures(self, theta: Params, pictures: Tensor, batch: Batch) -> dict[str, Tensor]:
        """Add the distances of colours, and of maps in even light from the quilt, and how soft their detail is."""
        distances = super().compare_pictures(theta, pictures, batch)
        chroma = chroma_deviations(pictures.flatten(0, 1)).unflatten(0, pictures.shape[:2])
        distances["colour"] = COLOUR_WEIGHT * (chroma - batch["chroma"][:, None]).abs().mean((1, 2))
        evenly_lit = remove_shading(pictures, batch["light"][:, None])
        quilts = move_tiles(theta["quilt"].detach(), batch["noise"])
        distances["deviation"] = quilt_deviation(evenly_lit, quilts)
        distances["softness"] = self.measure_softness(pictures, batch)
        return distances

    def measure_softness(self, pictures: Tensor, batch: Batch) -> Tensor:
        """Return the part of a loss, [T], that keeps the detail of pictures [T, B, 3, H, W] as fine as the exemplars'.

        It is 0 for pictures of coarser octaves.
        """
        if self.octaves.find_octave(batch):
            return pictures.new_zeros(len(pictures))
        return SOFTNESS_WEIGHT * detail_difference(detail_statistics(pictures), batch["detail"][:, None]).mean(1)

    @override
    def generate_maps(self, theta: Params, noise: Tensor, octave: int = 0) -> tuple[Maps, Tensor]:
        quilts, network = move_tiles(theta["quilt"].detach(), noise), self.network._replace(finest=octave)
        raw = network(theta, noise[:, :, : network.noise], normalise_quilts(quilts))
        return self.decode_maps(_add_quilt(remove_slow_changes(raw), quilts), self.octaves.octave_size(octave)[1])

    @override
    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph without its shading; see the base class."""
        photo = image.float() / 255
        exemplar = self.octaves.take_exemplar(photo[None])
        unshaded = self.statistics.even_light(exemplar, {"light": self.statistics.find_light(exemplar)})
        even = remove_quadratic_trend(unshaded[0])[None]
        factor, offset = (
            interpolate(values, size=photo.shape[-2:], mode="bilinear", align_corners=False)[0]
            for values in fit_local_lines(exemplar, even)
        )
        return (factor * photo + offset).clamp(0, 1)

    @override
    def photo_share(self, task: Task, size: tuple[int, int] | None) -> float:
        return task.data["image"].shape[-1] / size[1] if size else 1.0

    @override
    @torch.no_grad()
    def draw_maps(self, theta: Params, task: Task, size: tuple[int, int] | None) -> tuple[Maps, Tensor]:
        """Make the maps of a fit at the resolution of its photograph; they tile.

        Args:
            theta: a fit, with a task axis of length 1.
            task: the task that was fitted.
            size: height and width in texels, for which the tile is quilted once more; None for the photograph's. If the
                task holds no photograph, the tile has the size of the quilt in the fit, and a warning says so.

        Returns:
            Maps [C, H, W], and their height [1, H, W] in texels.
        """
        quilt = theta["quilt"]
        noise = self.shown_noise(quilt)[:, :, : self.network.noise]
        raw = remove_slow_changes(self.network(theta, noise, normalise_quilts(quilt[:, None]))[0])
        fine_quilt = self.fetch_quilt(theta, task, "the maps have").clamp(0, 1)
        photo_size = fine_quilt.shape[-2], fine_quilt.shape[-1]
        fine_raw = refine_relief(raw, quilt, fine_quilt)
        maps, height = self.decode_maps(_add_quilt(fine_raw, fine_quilt)[0], photo_size[1])
        if size is None or size == photo_size:
            return maps, height
        layers = torch.cat([_display(maps.diffuse), maps.specular, maps.roughness, height])
        colours = adaptive_avg_pool2d(layers[:3], self.cells)
        quilted = self.resize_tile_of_fit(task, layers, colours, size)
        diffuse, specular, roughness, height = quilted.split(LAYER_CHANNELS)
        # cubic interpolation overshoots
        diffuse, specular = (values.clamp(0, 1) for values in (diffuse, specular))
        return Maps(
            diffuse**DISPLAY_GAMMA, specular, roughness.clamp(LEAST_ROUGHNESS, 1), normal_from_height(height)
        ), height


def fit_local_lines(pictures: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Fit, in a window about each px, the line that makes targets of pictures.

    See He et al. 2010, "Guided image filtering". Factors and offsets vary slowly where targets have another light than
    pictures, so that they can be enlarged and applied to finer pictures.

    Args:
        pictures: display values [B, C, H, W].
        targets: display values [B, C, H, W].

    Returns:
        The factor and the offset of each px, [B, C, H, W] each.
    """

    def average(values: Tensor) -> Tensor:
        return avg_pool2d(values, LINE_WINDOW_PX, 1, LINE_WINDOW_PX // 2, count_include_pad=False)

    picture_mean, target_mean = average(pictures), average(targets)
    covariance = average(pictures * targets) - picture_mean * target_mean
    variance = average(pictures.square()) - picture_mean.square()
    # flat windows say nothing of the factor, so that the ratio of means counts there
    ratio = target_mean.clamp_min(LINE_DEVIATION) / picture_mean.clamp_min(LINE_DEVIATION)
    factor = average((covariance + LINE_DEVIATION**2 * ratio) / (variance + LINE_DEVIATION**2))
    return factor, target_mean - factor * picture_mean


def remove_slow_changes(values: Tensor) -> Tensor:
    """Remove from maps that tile, [..., C, H, W], changes over more than about 2 / SLOW_CELLS of a side; means stay."""
    maps = values.flatten(0, -4) if values.ndim > 4 else values
    cell_means = adaptive_avg_pool2d(maps, SLOW_CELLS)
    deviations = cell_means - cell_means.mean((-1, -2), keepdim=True)
    return values - enlarge_grid(deviations, maps.shape[-2:]).reshape(values.shape)


def refine_relief(raw: Tensor, quilt: Tensor, fine_quilt: Tensor) -> Tensor:
    """Enlarge raw maps to the size of a finer quilt, and continue the relief in the detail that only the latter shows.

    The finest detail of the height is a factor times the finest detail of brightness, in the least squares; so is the
    detail that is still finer. The factor is near 0 where brightness says nothing of the height.

    Args:
        raw: raw maps of the network, [T, 6, H, W].
        quilt: display values of that size, [T, 3, H, W].
        fine_quilt: the same quilt, finer, [T, 3, H', W'].

    Returns:
        Raw maps [T, 6, H', W'].
    """
    size = (fine_quilt.shape[-2], fine_quilt.shape[-1])
    if size == raw.shape[-2:]:
        return raw
    enlarged = enlarge_grid(raw, size)
    if size[0] < quilt.shape[-2]:
        return enlarged
    height, brightness = (
        values - enlarge_grid(avg_pool2d(values, 2), values.shape[-2:])
        for values in (raw[:, 5:], quilt.mean(1, keepdim=True))
    )
    factor = (height * brightness).sum((-1, -2), keepdim=True) / (
        brightness.square().sum((-1, -2), keepdim=True) + 1e-6
    )
    fine_brightness = fine_quilt.mean(1, keepdim=True)
    detail = fine_brightness - enlarge_grid(
        adaptive_avg_pool2d(fine_brightness, (quilt.shape[-2], quilt.shape[-1])), size
    )
    return torch.cat([enlarged[:, :5], enlarged[:, 5:] + factor * detail], 1)


def _add_quilt(raw: Tensor, quilts: Tensor) -> Tensor:
    """Add the logits of quilts [..., 3, H, W], display values, to the diffuse channels of raw maps [..., 6, H, W]."""
    diffuse, others = raw.split((3, 3), -3)
    return torch.cat([diffuse + torch.logit(quilts.clamp(*DISPLAY_RANGE)), others], -3)


def _display(linear: Tensor) -> Tensor:
    """Return linear values in [0, 1] as a display of DISPLAY_GAMMA shows them; gradients stay finite."""
    return linear.clamp_min(1e-3) ** (1 / DISPLAY_GAMMA)


def turn_maps(maps: Tensor, is_flipped: Tensor, is_transposed: Tensor, channels: Tensor) -> Tensor:
    """Change packed maps [10, H, W] as the picture over them is changed.

    Args:
        maps: packed by :func:`metapp.appearance.svbrdf_maps.pack_maps`.
        is_flipped, is_transposed: whether the picture is flipped from left to right, then transposed; bool [].
        channels: the number that each colour channel had before, [3].
    """
    normal, diffuse, roughness, specular = turn_picture(maps, bool(is_flipped), bool(is_transposed)).split((3, 3, 1, 3))
    x, y, z = normal.split(1)
    x = -x if is_flipped else x
    # y points up, against the rows
    x, y = (-y, -x) if is_transposed else (x, y)
    return torch.cat([x, y, z, diffuse[channels], roughness, specular[channels]])

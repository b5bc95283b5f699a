"""The sight of several flash photographs of one place.

A task with a single photograph needs no measured positions: it counts as photographed from straight above, with the
flash beside the lens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, relu
from typing_extensions import override

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.doubts import FLAT_RELIEF, UNEXPLAINED_AREAS, UNEXPLAINED_TEXELS, format_percent
from metapp.appearance.flash import camera_position
from metapp.appearance.highlight import F0_BOUND_CLAUSE, clipped_highlight_warnings
from metapp.appearance.svbrdf_maps import mean_tilt_degrees
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, render_photos
from metapp.apps.svbrdf_nonstationary.map_judge import RADIANCE_FLOOR, TrueMaps
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    CLIPPED_LINEAR_VALUE,
    decode_maps,
    decode_photo,
    encode_roughness,
)
from metapp.apps.svbrdf_nonstationary.material_sight import MaterialSight, draw_materials
from metapp.apps.svbrdf_nonstationary.multi_photo import stereo
from metapp.apps.svbrdf_nonstationary.multi_photo.flash_gains import estimate_flashes, log_floored_radiance
from metapp.apps.svbrdf_nonstationary.multi_photo.integrability import find_curl
from metapp.apps.svbrdf_nonstationary.multi_photo.obstructions import remove_obstructions
from metapp.apps.svbrdf_nonstationary.multi_photo.parallax import Heights, find_heights, remove_parallax
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_sets import draw_photo_sets
from metapp.apps.svbrdf_nonstationary.multi_photo.texel_maps import TexelFit, TexelMaps
from metapp.learning.components import VisibleData
from metapp.learning.rounding import round_absolute
from metapp.learning.task import Params, Task, Tasks, TensorSpec

# Initial values of the loss parameters that a rule may learn
ROUNDING = 0.02  # log radiance: |differences| of photographs and renderings are rounded off below
PRIOR_WEIGHT = 0.04  # weight of the distance from the prior, for each number of a texel
FLASH_WEIGHT = 0.02  # weight of the squared displacements of flashes from their measured positions
FALLOFF_WEIGHT = 1e-6  # weight of the squared fall-off of the flashes, no loss parameter that a rule learns
CURL_WEIGHT = 0.08  # weight of the |curl| of slopes
NOISE = 0.006  # log radiance: geometric mean of |differences| up to which these weights hold
CURL_ROUNDING = 0.05  # difference of slopes from texel to texel: |curls| of slopes are rounded off below
# Parallax is removed where heights deviate by so many texels, and where stereo's residual falls below this share.
MIN_HEIGHT_TEXELS, MAX_RESIDUAL_SHARE = 0.5, 0.95
# Initial maps by photometric stereo, from which Overfit begins
INITIAL_ROUGHNESSES = (0.15, 0.25, 0.35, 0.5, 0.7)  # candidates for the one roughness of the surface
INITIAL_MAPS_PX = 64  # largest side of the photographs that stereo reads; its maps are enlarged afterwards
COMPARED_BLOCKS = 8  # a side, over which photographs and renderings are averaged before they are compared


class SeenPhotos(NamedTuple):
    """Several photographs of one place as fits see them.

    Attributes:
        photo: the first linear photograph, [T, 3, H, W].
        photos: all N photographs, [T, N, 3, H, W], averaged over areas to the size of the maps, without parallax, see
            :func:`remove_parallax`, and filled where they show something else than the material, see
            :func:`remove_obstructions`.
        shows_material: 1 where photographs show the material, else 0, [T, N, 1, H, W].
        relief: what parallax tells of the heights of the surface, [T, RELIEF_CHANNELS, H, W]; see
            :meth:`Heights.describe`.
        places: the positions of camera and flash in half sides of the patch, [T, N, 2, 3].
    """

    photo: Tensor
    photos: Tensor
    shows_material: Tensor
    relief: Tensor
    places: Tensor


@dataclass(frozen=True)
class PhotoSetSight(MaterialSight[TexelFit, SeenPhotos]):
    """The sight of several photographs, which finds initial maps by photometric stereo."""

    observes = "photo"
    seen_type = SeenPhotos

    @override
    def prepare(self, task: Task, decoder: TexelMaps) -> SeenPhotos:
        """Prepare all photographs and places. Raises ValueError if there are not as many of the one as of the other."""
        photos, places = self.photos(task), self.read_cameras(task)
        if len(places) != len(photos):
            raise ValueError(
                f"{task.name}: {len(photos)} photos and {len(task.data.get('places', ()))} places, expected as many; "
                "convert it again."
            )
        linear = decode_photo(photos)
        aligned, relief = _align_photos(linear, places, decoder.size)
        filled, shows_material = remove_obstructions(aligned, places)
        return SeenPhotos(adaptive_avg_pool2d(linear[0], decoder.size), filled, shows_material, relief, places)

    @override
    def read_cameras(self, task: Task) -> Tensor:
        """Return the positions of camera and flash of a task's photographs, [N, 2, 3], in half sides of the patch."""
        return task.data.get("places", camera_position().expand(1, 2, 3)).float()

    @override
    def photos(self, task: Task) -> Tensor:
        return torch.stack([task.data["photo"], *task.data.get("others", ())])

    @override
    def augment(self, tasks: Tasks, side: int, rng: Generator) -> tuple[SeenPhotos, TrueMaps]:
        materials, truth = draw_materials(tasks, side, rng)
        photos, places = draw_photo_sets(materials, tasks.data["places"].shape[1], rng)
        pairs = zip(photos, places, strict=True)
        aligned, relief = map(torch.stack, zip(*(_align_photos(*pair, (side, side)) for pair in pairs), strict=True))
        return SeenPhotos(aligned[:, 0], aligned, torch.ones_like(aligned[:, :, :1]), relief, places), truth

    @override
    def task_parameters(self, tasks: Tasks, decoder: TexelMaps) -> Params:
        """Return initial maps and flashes, by photometric stereo in closed form.

        Stereo finds slopes and diffuse colour, not the roughness. So the whole surface of a task gets one roughness: of
        INITIAL_ROUGHNESSES the one with the lowest loss. All this is done on photographs of at most INITIAL_MAPS_PX a
        side; then the maps are enlarged to the size of fits.

        Returns:
            `maps` [T, 9, H, W], `flash` [T, FLASH_NUMBERS, N] and `falloff` [T, 1], 0.
        """
        seen, (height, width) = self.gather(tasks), decoder.size
        photos = _pool_photos(seen.photos, (min(INITIAL_MAPS_PX, height), min(INITIAL_MAPS_PX, width)))
        small = seen._replace(photos=photos, shows_material=torch.ones_like(photos[:, :, :1]))
        reading = stereo.read_stereo(photos, seen.places)
        slopes, diffuse, roughness_numbers, specular = reading.maps.split(CHANNELS, 1)
        candidates, losses = [], []
        for roughness in INITIAL_ROUGHNESSES:
            number = encode_roughness(torch.full_like(roughness_numbers, roughness))
            maps = torch.cat([slopes, diffuse, number, specular], 1)
            flash = estimate_flashes(decode_maps(maps), photos, seen.places)
            candidates.append({"maps": maps, "flash": flash, "falloff": maps.new_zeros(len(maps), 1)})
            losses.append(self.loss(decoder(candidates[-1], small), small, {}))
        best = torch.stack(losses).argmin(0), torch.arange(len(photos), device=photos.device)
        theta = {key: torch.stack([candidate[key] for candidate in candidates])[best] for key in candidates[0]}
        return theta | {"maps": interpolate(theta["maps"], (height, width), mode="bilinear")}

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the numbers of N flashes, which the decoder draws for one, and of their fall-off.

        Fits of earlier versions lack the fall-off.
        """
        return {"flash": TensorSpec((FLASH_NUMBERS, "N")), "falloff": TensorSpec((1,), optional=True)}

    @override
    def loss(self, answer: TexelFit, seen: SeenPhotos, loss_parameters: Params) -> Tensor:
        """Return the negative log posterior of each task, [T], summed over texels.

        It has these terms: rounded |differences| of log photographs and log renderings; squared displacements of the
        flashes, and their squared fall-off; and, where a task has a prior, rounded |distances| of the maps from it, and
        the rounded |curl| of slopes, which are the gradient of a height. Where a photograph clips, only darker
        renderings differ from it; where it does not show the material, none does.
        """
        parameters, photos = self.settings(loss_parameters, answer.numbers), seen.photos
        residual = log_floored_radiance(photos) - log_floored_radiance(render_photos(answer.maps, answer.flash))
        residual = torch.where(photos > CLIPPED_LINEAR_VALUE, relu(residual), residual) * seen.shows_material
        loss = round_absolute(residual, parameters["smoothing"].exp()).mean((1, 2, 3, 4))
        loss = loss + parameters["flash"].exp() * answer.flash_numbers[:, :-1].square().mean((1, 2))
        loss = loss + FALLOFF_WEIGHT * answer.falloff.square().mean(1)
        if answer.prior is not None:
            mean, log_scale = answer.prior.detach().chunk(2, 1)
            distances = round_absolute((answer.numbers - mean) * (-log_scale).exp(), photos.new_ones(())).mean((2, 3))
            priors = (distances * parameters["prior"].exp()).sum(1)
            curls = round_absolute(find_curl(answer.numbers[:, : CHANNELS[0]]), photos.new_tensor(CURL_ROUNDING))
            texel_count = photos.shape[-2] * photos.shape[-1]
            priors = priors + curls.sum((1, 2)) / texel_count * parameters["curl"].exp()
            # The more photographs there are, the less priors count beside their mean.
            loss = loss + priors / photos.shape[1]
        return loss * (photos.shape[-2] * photos.shape[-1])

    def settings(self, loss_parameters: Params, like: Tensor) -> Params:
        """Return all loss parameters, with a leading axis of tasks: learned values, else the initial ones.

        Args:
            loss_parameters: the values that a rule has learned for the current step, [T, ...]; {} for none.
            like: a tensor [T, ...] that gives initial values their number of tasks, dtype and device.

        Returns:
            `smoothing` [T], `prior` [T, 9], `flash` [T], `curl` [T] and `noise` [T], the parameters of
            :meth:`initial_loss_parameters`.
        """
        if loss_parameters:
            return loss_parameters
        initial = self.initial_loss_parameters(1)
        return {key: value.expand(len(like), *value.shape[1:]).to(like) for key, value in initial.items()}

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values of the loss parameters, which are logs, with a leading axis of steps.

        A rule learns other values for each step. The initial values are equal at all steps.

        Returns:
            `smoothing` [steps], the log of ROUNDING; `prior` [steps, 9], the log of PRIOR_WEIGHT for each number of a
            texel; `flash` [steps], the log of FLASH_WEIGHT; `curl` [steps], the log of CURL_WEIGHT; `noise` [steps],
            the log of NOISE.
        """
        values = {
            "smoothing": torch.tensor(ROUNDING),
            "prior": torch.full((sum(CHANNELS),), PRIOR_WEIGHT),
            "flash": torch.tensor(FLASH_WEIGHT),
            "curl": torch.tensor(CURL_WEIGHT),
            "noise": torch.tensor(NOISE),
        }
        return {key: value.log().expand(steps, *value.shape).clone() for key, value in values.items()}

    @override
    def fit_remarks(self, answer: TexelFit, task: Task) -> dict[str, object]:
        """Return the mean tilt of fitted normals, and the number of photographs."""
        counts = {"photos": len(self.photos(task))}
        return {"mean_tilt_degrees": mean_tilt_degrees(answer.maps.normal), "counts": counts}

    @override
    def quality_warnings(self, answer: TexelFit, seen: SeenPhotos) -> list[list[str]]:
        """Return for each task clauses on photographs and relief.

        They are on clipping, where all photographs clip, on parts of photographs that were left out, since they show
        something else than the material, on relief that is about as low as its errors, and on photographs that the maps
        do not explain.
        """
        renderings = render_photos(answer.maps, answer.flash)
        return [
            [
                *clipped_highlight_warnings(linear_to_srgb(photos.amin(0)), F0_BOUND_CLAUSE, "all photos"),
                *_left_out_warnings((1 - shows_material.mean((1, 2, 3))).tolist()),
                *FLAT_RELIEF.about(mean_tilt_degrees(normal[None])),
                *_unexplained_warnings(photos, rendering, shows_material),
            ]
            for photos, shows_material, normal, rendering in zip(
                seen.photos, seen.shows_material, answer.maps.normal, renderings, strict=True
            )
        ]

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return what steps see, all photographs, which General's encoder reads, too."""
        count = len(self.photos(task))
        return VisibleData(count, task.data["photo"].nbytes, count)


def _align_photos(photos: Tensor, places: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Average photographs over areas to a size, without parallax.

    Args:
        photos: linear photographs [N, 3, h, w].
        places: positions of camera and flash, [N, 2, 3], in half sides of the patch.
        size: the height H and width W of the result.

    Returns:
        The photographs, [N, 3, H, W], and what parallax tells of heights, [RELIEF_CHANNELS, H, W]. Heights below the
        noise, or by which stereo does not explain the photographs better, count as none, and photographs stay.
    """
    coarse, eyes = adaptive_avg_pool2d(photos, size), places[:, 0]
    heights = find_heights(photos, eyes, size)
    if heights.height.std() * size[1] / 2 >= MIN_HEIGHT_TEXELS:
        moved = remove_parallax(coarse, eyes, heights.height)
        if stereo.stereo_residual(moved, places) <= MAX_RESIDUAL_SHARE * stereo.stereo_residual(coarse, places):
            return moved, heights.describe()
    return coarse, Heights.unknown(heights.height).describe()


def _pool_photos(photos: Tensor, size: tuple[int, int]) -> Tensor:
    """Average photographs [T, N, 3, H, W] over areas to another size."""
    pooled: Tensor = adaptive_avg_pool2d(photos.flatten(0, 1), size).unflatten(0, photos.shape[:2])
    return pooled


def _unexplained_warnings(photos: Tensor, renderings: Tensor, shows_material: Tensor) -> list[str]:
    """Return a clause on how far photographs differ from renderings of the maps; [] where they agree.

    Differences over wide areas come first; else those from texel to texel count, by their median.

    Args:
        photos: linear photographs [N, 3, H, W].
        renderings: the same photographs, rendered from the maps.
        shows_material: 1 where photographs show the material, else 0, [N, 1, H, W].
    """
    logs = (photos + RADIANCE_FLOOR).log() - (renderings.clamp(0, 1) + RADIANCE_FLOOR).log()
    difference = float(adaptive_avg_pool2d(logs.mean(1, keepdim=True) * shows_material, COMPARED_BLOCKS).std())
    noise = float(logs.abs()[shows_material.expand_as(logs) > 0].median())
    return UNEXPLAINED_AREAS.about(difference) or UNEXPLAINED_TEXELS.about(noise)


def _left_out_warnings(shares: Sequence[float]) -> list[str]:
    """Return a clause on the parts of photographs that were left out, given their shares; [] where none was."""
    parts = [f"{format_percent(share)} of photo {number}" for number, share in enumerate(shares, 1) if share]
    return [f"{' and '.join(parts)} left out, where others disagree: an object or a shadow?"] if parts else []

"""Non-stationary svBRDFs from several flash photographs of one place: the application.

A batch holds N linear photographs of each task, `photos` [T, N, 3, H, W], and measured positions, `places`
[T, N, 2, 3]: of each photograph first the camera's position, then the flash's, in half sides of the patch. A task with
a single photograph needs no places: it counts as photographed from straight above, with the flash beside the lens.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate, relu
from typing_extensions import override

from metapp.appearance.flash_rendering import camera_position
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, Flash, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    CLIPPED_LINEAR_VALUE,
    decode_maps,
    decode_photo,
    encode_maps,
    encode_roughness,
    find_slopes,
    map_differences,
    pool_maps,
)
from metapp.apps.svbrdf_nonstationary.several import stereo, stereo_encoder
from metapp.apps.svbrdf_nonstationary.several.flash_gains import estimate_flashes, log_radiance
from metapp.apps.svbrdf_nonstationary.several.integrability import find_curl
from metapp.apps.svbrdf_nonstationary.several.obstructions import remove_obstructions
from metapp.apps.svbrdf_nonstationary.several.parallax import Heights, find_heights, remove_parallax
from metapp.apps.svbrdf_nonstationary.several.photo_sets import draw_photo_sets
from metapp.apps.svbrdf_nonstationary.variants import vary_materials
from metapp.learning.rounding import round_absolute
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

# Initial values of the loss parameters that a rule may learn
ROUNDING = 0.02  # log radiance: |differences| of photographs and renderings are rounded off below
PRIOR_WEIGHT = 0.04  # weight of the distance from the prior, for each number of a texel
FLASH_WEIGHT = 0.02  # weight of the squared displacements of flashes from their measured positions
FALLOFF_WEIGHT = 1e-6  # weight of the squared fall-off of the flashes, no loss parameter that a rule learns
CURL_WEIGHT = 0.08  # weight of the |curl| of slopes
NOISE = 0.006  # log radiance: geometric mean of |differences| up to which these weights hold
CURL_ROUNDING = 0.05  # difference of slopes from texel to texel: |curls| of slopes are rounded off below
# Parallax is removed where heights deviate by so many texels, and where stereo's residual falls below this share.
# 12 flat plates have less than 0.5 texels, or shares of 0.98 to 1.25; of relief by a phone 7 of 9 sets have 1.0 to 2.1
# texels and shares of 0.74 to 0.93, two without details 0.99 and 1.01.
MIN_HEIGHT_TEXELS, MAX_RESIDUAL_SHARE = 0.5, 0.95
# Weight in the outer loss of a negative log likelihood: of the errors of General's maps, given the scales it predicts
LIKELIHOOD_WEIGHT = 0.05
# Initial maps by photometric stereo, from which Overfit begins
INITIAL_ROUGHNESSES = (0.15, 0.25, 0.35, 0.5, 0.7)  # candidates for the one roughness of the surface
INITIAL_MAPS_PX = 64  # largest side of the photographs that stereo reads; its maps are enlarged afterwards


class Texels(NamedTuple):
    """A substitute for a network, for fits whose parameters are the maps themselves.

    The maps are stored as nine unbounded numbers for each texel, which :func:`decode_maps` turns into maps.

    Attributes:
        height, width: the size of the maps in texels.
        periodic: whether the maps tile; False, since the maps of a photographed place do not.
    """

    height: int
    width: int
    periodic: bool = False

    def init(self, rng: Generator, count: int) -> Params:
        """Return the numbers of flat grey maps, `maps` [count, 9, height, width]."""
        return {"maps": torch.zeros(count, sum(CHANNELS), self.height, self.width, device=rng.device)}


@dataclass(frozen=True)
class SeveralPhotos(SvbrdfNonstationary):
    """The application whose fits see several flash photographs of one place.

    The parameters of a fit are unbounded numbers: `maps` [T, 9, H, W] stands for the maps, `flash`
    [T, FLASH_NUMBERS, N] for the flashes, and `falloff` [T, 1] is the fall-off that the flashes of a task share, see
    :class:`Flash`. A fit that begins at General's maps is kept near them by another parameter, `prior`
    [T, 18, H, W], which no step changes: at each texel the nine numbers that the prior expects, then the logs of the
    nine scales by which they may be off.
    """

    network: Texels = field(default=Texels(256, 256))
    observes = "photo"
    several_photos = True

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare one material: what every non-stationary svBRDF has, all its photographs, and their places.

        Returns:
            The tensors that :meth:`SvbrdfNonstationary.prepare` returns; `photos` [N, 3, H, W], all linear photographs,
            averaged over areas to the size of the maps, without parallax, see :func:`remove_parallax`, and filled where
            they show something else than the material, see :func:`remove_obstructions`; `unobstructed` [N, 1, H, W], 1
            where they show it, else 0; `relief` [RELIEF_CHANNELS, H, W], what parallax tells of the heights of the
            surface, see :meth:`Heights.describe`; and `places` [N, 2, 3], the positions of camera and flash in half
            sides of the patch.

        Raises:
            ValueError: there are not as many places as photographs.
        """
        photos = torch.stack([task.data["photo"], *task.data.get("others", ())])
        places = _task_places(task)
        if len(places) != len(photos):
            raise ValueError(
                f"{task.name}: {len(photos)} photos and {len(task.data.get('places', ()))} places, expected as many; "
                "convert it again."
            )
        aligned, relief = _align_photos(decode_photo(photos), places, (self.network.height, self.network.width))
        filled, shows_material = remove_obstructions(aligned, places)
        seen = {"photos": filled, "unobstructed": shows_material, "relief": relief, "places": places}
        return super().prepare(task) | seen

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        """Return initial maps and flashes, by photometric stereo in closed form.

        Stereo finds slopes and diffuse colour, not the roughness. So the whole surface of a task gets one roughness: of
        INITIAL_ROUGHNESSES the one with the lowest loss. All this is done on photographs of at most INITIAL_MAPS_PX a
        side; then the maps are enlarged to the size of fits.

        Returns:
            `maps` [T, 9, H, W], `flash` [T, FLASH_NUMBERS, N] and `falloff` [T, 1], 0.
        """
        batch, network = self.encoder_input(tasks, Generator()), self.network
        size = (min(INITIAL_MAPS_PX, network.height), min(INITIAL_MAPS_PX, network.width))
        batch["photos"] = _pool_photos(batch["photos"], size)
        reading = stereo.read_photos(batch["photos"], batch["places"])
        slopes, diffuse, _, specular = reading.maps.split(CHANNELS, 1)
        candidates, losses = [], []
        for roughness in INITIAL_ROUGHNESSES:
            roughness_numbers = encode_roughness(torch.full_like(slopes[:, :1], roughness))
            maps = torch.cat([slopes, diffuse, roughness_numbers, specular], 1)
            flashes = {"flash": estimate_flashes(decode_maps(maps), batch), "falloff": _no_falloff(maps)}
            candidates.append({"maps": maps, **flashes})
            losses.append(self.loss(candidates[-1], batch, {}))
        best = torch.stack(losses).argmin(0), torch.arange(len(tasks), device=tasks.rows.device)
        theta = {key: torch.stack([candidate[key] for candidate in candidates])[best] for key in candidates[0]}
        return theta | {"maps": interpolate(theta["maps"], (network.height, network.width), mode="bilinear")}

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the numbers of N flashes, and of their fall-off, which fits of earlier versions lack.

        `init` draws the numbers of a single flash: the rates that a learned rule has for these hold for all flashes.
        """
        return {"flash": TensorSpec((FLASH_NUMBERS, "N")), "falloff": TensorSpec((1,), optional=True)}

    @override
    def maps_of(self, theta: Params, photo: Tensor) -> Maps:
        """Return the fitted maps, enlarged to the size of photographs if these have another size than the maps.

        Enlarged maps are smooth. So the diffuse colour is multiplied by the detail of the photograph that is finer than
        the fitted maps: its ratio to its own geometric mean over each texel of the maps, smoothly enlarged.

        Args:
            theta: fits [T, ...].
            photo: one linear photograph of each task, [T, 3, h, w], in [0, 1].

        Returns:
            The maps, [T, C, h, w].
        """
        size = photo.shape[-2:]
        if size == theta["maps"].shape[-2:]:
            return decode_maps(theta["maps"])
        maps, logs = decode_maps(interpolate(theta["maps"], size, mode="bicubic")), log_radiance(photo)
        coarse_logs = adaptive_avg_pool2d(logs, (self.network.height, self.network.width))
        log_detail = logs - interpolate(coarse_logs, size, mode="bicubic")
        return maps._replace(diffuse=(maps.diffuse * log_detail.exp()).clamp(0, 1))

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the negative log posterior of each task, [T], summed over texels.

        It has these terms: rounded |differences| of log photographs and log renderings; squared displacements of the
        flashes, and their squared fall-off; and, where a task has a prior, rounded |distances| of the maps from it, and
        the rounded |curl| of slopes, which are the gradient of a height. Where a photograph clips, only darker
        renderings differ from it; where it does not show the material, none does.
        """
        parameters = self.settings(loss_parameters, theta["maps"])
        photos = batch["photos"]
        flashes = decode_flash(theta["flash"].mT, batch["places"], theta["falloff"], camera="held")
        residual = log_radiance(photos) - log_radiance(render_photos(decode_maps(theta["maps"]), flashes))
        residual = torch.where(photos > CLIPPED_LINEAR_VALUE, relu(residual), residual)
        residual = residual * batch.get("unobstructed", 1)
        loss = round_absolute(residual, parameters["smoothing"].exp()).mean((1, 2, 3, 4))
        loss = loss + parameters["flash"].exp() * theta["flash"][:, :-1].square().mean((1, 2))
        loss = loss + FALLOFF_WEIGHT * theta["falloff"].square().mean(1)
        if "prior" in theta:
            mean, log_scale = theta["prior"].detach().chunk(2, 1)
            distances = round_absolute((theta["maps"] - mean) * (-log_scale).exp(), photos.new_ones(())).mean((2, 3))
            priors = (distances * parameters["prior"].exp()).sum(1)
            curls = round_absolute(find_curl(theta["maps"][:, : CHANNELS[0]]), photos.new_tensor(CURL_ROUNDING))
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
            `smoothing` [T], `prior` [T, 9], `flash` [T], `curl` [T] and `noise` [T]; see :meth:`loss_parameters`.
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
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return differences between fitted and true maps, weighted, and a term that trains General's prior: sums [T].

        The differences are mean absolute ones: of log radiance under random lights, normals, slopes, diffuse and
        specular colour, and roughness. The difference of normals counts a second time in relation to how tilted the
        true normals are, so that low relief counts, too. The last term trains nothing but the scales that General
        predicts with its maps: the negative log likelihood of the errors of these maps, if each error has a Laplace
        distribution of the predicted scale.
        """
        maps, target = decode_maps(theta["maps"]), unpack_maps(batch["maps"])
        differences = map_differences(maps, target)
        diffuse, specular, roughness, normal = (difference.abs().mean((1, 2, 3)) for difference in differences)
        slope_error = (find_slopes(maps.normal) - find_slopes(target.normal)).abs().mean((1, 2, 3))
        mean_tilt = target.normal[:, :2].abs().sum(1).mean((1, 2)) / 3
        loss = 0.5 * self.radiance_difference(maps, target, batch["pairs"])
        loss = loss + 2 * normal + 0.15 * normal / (mean_tilt + 0.03)
        loss = loss + 0.5 * slope_error + 0.7 * diffuse + 0.5 * specular + roughness
        mean, log_scale = theta["prior"].chunk(2, 1)
        negative_log_likelihood = (mean - encode_maps(target)).detach().abs() * (-log_scale).exp() + log_scale
        return loss + LIKELIHOOD_WEIGHT * negative_log_likelihood.mean((1, 2, 3))

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw random parameters of the network that corrects photometric stereo."""
        return stereo_encoder.init(rng)

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return `photos`, `places` and `relief`, from which General predicts maps; see :meth:`prepare`."""
        return {key: tasks.data[key][tasks.rows] for key in ("photos", "places", "relief")}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Return General's maps, the flashes whose brightness agrees with them, and these maps as the prior."""
        reading = stereo.read_photos(encoder_input["photos"], encoder_input["places"])
        maps, log_scales = stereo_encoder.predict_maps(encoder, reading, encoder_input["relief"])
        # General predicts one scale for each kind of map: all numbers of that kind share it.
        expanded_scales = [
            log_scale.expand(-1, count, -1, -1)
            for log_scale, count in zip(log_scales.split(1, 1), CHANNELS, strict=True)
        ]
        return {
            "maps": maps,
            "flash": estimate_flashes(decode_maps(maps), encoder_input),
            "falloff": _no_falloff(maps),
            "prior": torch.cat([maps, *expanded_scales], 1),
        }

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return maps, flashes and their fall-off; the prior is not kept."""
        return {key: value for key, value in theta.items() if key != "prior"}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Vary the materials, and take several photographs of each."""
        size = (self.network.height, self.network.width)
        fine = vary_materials(tasks.data["fine"][tasks.rows].float(), self.shot_size, rng)
        photos, places = draw_photo_sets(fine, tasks.data["places"].shape[1], rng)
        pairs = zip(photos, places, strict=True)
        aligned, relief = map(torch.stack, zip(*(_align_photos(*pair, size) for pair in pairs), strict=True))
        seen = {"photo": aligned[:, 0], "photos": aligned, "places": places, "relief": relief}
        return tasks.make_variants(seen | self.describe_maps(pool_maps(fine, size)))

    @override
    def flashes(self, theta: Params, task: Task) -> list[Flash]:
        """Return one flash for each photograph of a task, in the order of the photographs.

        Args:
            theta: the parameters of one fit, without a task axis.
            task: the task of the fit, which states the measured positions.

        Returns:
            N flashes without a task axis: `place` [3], `gain` [1], `eye` [3] and `falloff` [].

        Raises:
            ValueError: the fit, which anybody may have written, has not as many flashes as the task has photographs.
        """
        places = _task_places(task)[None]
        if theta["flash"].shape[1] != places.shape[1]:
            counts = f"{theta['flash'].shape[1]} flashes, expected {places.shape[1]}, one for each photo"
            raise ValueError(f"{task.name}: a fit with {counts}; fit anew.")
        # Fits that were saved before flashes had a fall-off have none.
        falloff = theta.get("falloff", theta["flash"].new_zeros(1))
        flash = decode_flash(theta["flash"][None].mT, places, falloff[None], camera="held")
        return [Flash(*(part[0, number] for part in flash)) for number in range(places.shape[1])]


def _no_falloff(maps: Tensor) -> Tensor:
    """Return the fall-off of flashes with which fits of maps [T, C, H, W] begin: zeros [T, 1]."""
    return maps.new_zeros(len(maps), 1)


def _task_places(task: Task) -> Tensor:
    """Return the positions of camera and flash of a task's photographs, [N, 2, 3], in half sides of the patch.

    A task without places counts as one photograph from straight above.
    """
    return task.data.get("places", camera_position().expand(1, 2, 3)).float()


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

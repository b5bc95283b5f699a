"""Non-stationary svBRDFs from one photograph whose General reads features of VGG-16: the fields, losses and fits.

A fit differs from a fit of :class:`metapp.apps.svbrdf_nonstationary.coded_maps.FromPhoto` in where its maps come from:
they are the mean of two fields, and steps change the code of the second field and the flash alone. The features
themselves are read in :mod:`metapp.apps.svbrdf_nonstationary.pretrained.encoder`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.features import feature_conditions
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, blots
from metapp.apps.svbrdf_nonstationary.coded_maps import BLOTS_WEIGHT, MAPS_WEIGHT, PHOTO_WEIGHT, FromPhoto, photo_loss
from metapp.apps.svbrdf_nonstationary.flashes import render_photo
from metapp.apps.svbrdf_nonstationary.maps import (
    CHANNELS,
    ROUGHNESS_CHANNEL,
    decode_maps,
    map_differences,
    pixel_inputs,
)
from metapp.apps.svbrdf_nonstationary.pretrained.augmentation import draw_variants
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import (
    FULL_APP,
    PARTS,
    full_encoder,
    init_decoder,
    laplace_scales,
    negative_log_likelihood,
    read_photos,
    unknown_deviation,
)
from metapp.apps.svbrdf_nonstationary.pretrained.polish import roughness_shift, scale_roughness
from metapp.apps.svbrdf_nonstationary.pretrained.scars import hidden_share, remove_scars, trust_texels
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import add_decoder, join_encoder, select_reader
from metapp.networks.field import LocalField

PART_WEIGHTS = (1.0, 1.0, 4.0, 10.0)  # weights of the differences of maps, in the order of PARTS
# The predicted slope that is halved before the gain, and the gain of all slopes; chosen by validation materials
HALVED_SLOPE, SLOPE_GAIN = 0.1, 1.5
LIKELIHOOD_WEIGHT = 0.03  # weight in the outer loss of the likelihood of predicted errors, which moves these alone
INITIAL_SLOPE_GAIN = 0.05  # factor of slopes of untrained fields, whose maps are nearly flat
PATCH_KEYS = ("overview", "highlight", "guess", "code", "flash")  # what `describe_patch` returns
DECODER_PREFIX = "decoder."  # of names of General's parameters that tasks share
FULL_PREFIX = "full."  # of names of the parameters of the field of the recipe "full"
FULL_SHARE = 0.5  # weight of that field in diffuse colour, roughness and specular colour; it has none in slopes


class MeanField(LocalField):
    """A field beside the field of the recipe "full": the mean of both, but slopes of the first alone.

    Networks with other features and other training materials make other errors, which the mean lowers. `z` holds the
    codes of both fields, that of the first field first.
    """

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of both fields, [count, ...] each."""
        full = FULL_APP.network._replace(rows=self.rows, columns=self.columns)
        theta, full_theta = super().init(rng, count), full.init(rng, count)
        z = torch.cat([theta["z"], full_theta.pop("z")], 1)
        return theta | {f"{FULL_PREFIX}{key}": value for key, value in full_theta.items()} | {"z": z}

    @override
    def evaluate(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """Evaluate the mean of both fields; `code` has the codes of both at the texels, the first field's first."""
        return self.mix_outputs(*self.evaluate_both(theta, code, places))

    def evaluate_both(self, theta: Params, code: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the first field and the field of "full" at texels, [T, outputs, h, w] each; see :meth:`evaluate`."""
        full_theta = {
            key.removeprefix(FULL_PREFIX): value for key, value in theta.items() if key.startswith(FULL_PREFIX)
        }
        first_output = super().evaluate(theta, code[:, : self.code], places)
        return first_output, FULL_APP.network.evaluate(full_theta, code[:, self.code :], places)

    def mix_outputs(self, first_output: Tensor, full_output: Tensor) -> Tensor:
        """Return the mean of both outputs [T, outputs, h, w], weighted by FULL_SHARE; slopes are of the first alone."""
        slopes, rest = first_output.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
        return torch.cat([slopes, torch.lerp(rest, full_output[:, CHANNELS[0] :], FULL_SHARE)], 1)


@dataclass(frozen=True)
class FromFeatures(FromPhoto):
    """The application whose fits of one photograph begin at General's maps by features of VGG-16.

    General draws no relief that a photograph does not show. Beside `maps` a training task may hold `map_weights` [4],
    weights of the loss of the maps in the order of PARTS, 0 where a map is made up.
    """

    network: MeanField = field()

    @property
    @override
    def read_size(self) -> int:
        return FINEST_PX

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device)

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add the weights of the losses of maps, `map_weights` [4]: those that the task states, else ones."""
        map_weights = task.data.get("map_weights", torch.ones(len(PARTS)))
        return super().prepare(task) | {"map_weights": map_weights.float()}

    @override
    def init(self, rng: Generator, count: int) -> Params:
        """Draw parameters of maps that are nearly flat, as steps of fits leave normals as they are."""
        return _scale_slopes(super().init(rng, count)) | unknown_deviation(count, rng.device)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        """Draw the decoder and the first field, whose maps are nearly flat: training begins without relief."""
        first_field = LocalField(*self.network)
        return join_encoder(init_decoder(rng, first_field.code), _scale_slopes(first_field.init(rng, 1)), ("z",))

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Draw windows of half the field's side of augmented materials, photographed anew."""
        fine, map_weights = (tasks.data[key][tasks.rows].float() for key in ("fine", "map_weights"))
        return tasks.make_variants(draw_variants(fine, map_weights, self.network.height // 2, rng))

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the photographs; of windows also the inputs of the field and what is known of the whole patch."""
        window = {key: tasks.data[key][tasks.rows] for key in ("inputs", *PATCH_KEYS) if key in tasks.data}
        return super().encoder_input(tasks, rng) | window

    @override
    def read(self, reader: Params, photos: Tensor, place: Tensor | None = None, patch: Params | None = None) -> Params:
        """Return what `read_photos` reads, with codes and flash in the units of the fields' parameters."""
        parameters = read_photos(reader, photos, place, patch)
        return parameters | {key: parameters[key] / self.network.gain for key in ("z", "flash")}

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Return parameters of both fields; windows, which training alone sees, have a code in each of their pixels."""
        full_parameters = full_encoder(encoder_input["photo"].device).items()
        full_decoder = {
            key.replace(DECODER_PREFIX, DECODER_PREFIX + FULL_PREFIX): value
            for key, value in full_parameters
            if key.startswith(DECODER_PREFIX)
        }
        if "inputs" not in encoder_input:
            theta = super().encode(encoder | full_decoder, encoder_input)
            return _apply_polish(theta, self.maps_of(theta, encoder_input["photo"]), encoder_input.get("height"))
        place = encoder_input["inputs"][:, -2:]
        patch = {key: encoder_input[key] for key in PATCH_KEYS if key in encoder_input}
        parameters = self.read(select_reader(encoder), encoder_input["photo"], place, patch or None)
        theta = add_decoder(parameters, encoder | full_decoder)
        return _apply_polish(theta, self._evaluate_maps(theta, encoder_input["inputs"]))

    @override
    def postprocess(self, theta: Params) -> Params:
        """Return fits without predicted errors, which training alone reads."""
        return {key: value for key, value in theta.items() if key != "deviation"}

    @override
    def maps_from(self, raw: Tensor) -> Maps:
        """Return the maps of outputs of fields, with slopes s changed to SLOPE_GAIN s |s|^2 / (|s|^2 + HALVED_SLOPE^2).

        The network makes conditional means; the mean difference of normals asks for medians, which are flat where a
        photograph tells little, and steeper where it tells a lot.
        """
        slopes, rest = raw.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
        square = slopes.square().sum(1, keepdim=True)
        return super().maps_from(torch.cat([SLOPE_GAIN * square / (square + HALVED_SLOPE**2) * slopes, rest], 1))

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference from the photograph, [T], which moves the code of "full" and the flash alone.

        So normals stay those of General: a photograph under one light says less of them than General has read. Texels
        beneath a highlight count less, see :func:`trust_texels`.
        """
        fixed_theta = {key: value.detach() for key, value in theta.items()}
        code = self.network.gain * theta["z"]
        first_output, full_output = self.network.evaluate_both(fixed_theta, code, pixel_inputs(batch["photo"]))
        maps = self.maps_from(self.network.mix_outputs(first_output.detach(), full_output))
        flash = self.flash_of(self._move_flash(theta, batch))
        radiance = render_photo(maps, flash)
        return photo_loss(radiance, batch["photo"], loss_parameters, trust_texels(maps, radiance, flash))

    @override
    def hidden_share(self, theta: Params, maps: Maps) -> Tensor:
        return hidden_share(maps, self.flash_of(theta))

    @override
    def fill(self, theta: Params, maps: Maps, photo: Tensor) -> Maps:
        """Remove scars of highlights; see :func:`remove_scars`. Then fill maps where photographs clip."""
        return super().fill(theta, remove_scars(maps, photo, self.flash_of(theta)), photo)

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the difference of the maps and of their radiance under random lights, [T]; made-up maps do not count.

        Normals learn from their squared error alone, over the deviation that General predicts. Its minimum is the
        conditional mean, which is flat where the photograph does not tell.
        """
        inputs = batch["inputs"] if "inputs" in batch else pixel_inputs(batch["photo"])
        map_weights, target = batch["map_weights"], unpack_maps(batch["maps"])
        batch = batch | {"place": inputs[:, -2:]}
        maps = self._evaluate_maps(theta, inputs)
        differences = map_differences(maps, target)
        scale = laplace_scales(theta)[:, -1:].detach()
        squared = differences[-1].square() / scale.repeat_interleave(4, -1).repeat_interleave(4, -2)
        errors = torch.stack([difference.abs().mean((1, 2, 3)) for difference in (*differences[:-1], squared)], 1)
        map_loss = (errors * map_weights * errors.new_tensor(PART_WEIGHTS)).sum(1)
        blot_loss = map_weights[:, 0] * blots(differences[0], batch["photo"])
        is_known = map_weights[:, 1:3, None, None, None] > 0  # pictures do not count where maps are made up
        specular = torch.where(is_known[:, 0], maps.specular, target.specular)
        roughness = torch.where(is_known[:, 1], maps.roughness, target.roughness)
        # pictures are of the true normals: the median of a highlight lies at a slope even where the mean slope is 0
        shown_maps = Maps(maps.diffuse, specular, roughness, target.normal)
        pictures = self.radiance_difference(shown_maps, target, batch["pairs"], batch["place"])
        loss = map_weights[:, 3] * (pictures + PHOTO_WEIGHT * self.photo_difference(theta, shown_maps, batch, {}))
        likelihood = negative_log_likelihood(differences, theta) * map_weights.amin(1)
        return loss + MAPS_WEIGHT * map_loss + BLOTS_WEIGHT * blot_loss + LIKELIHOOD_WEIGHT * likelihood

    def _evaluate_maps(self, theta: Params, inputs: Tensor) -> Maps:
        """Return the maps [T, C, h, w] of fields with a code in each texel, for inputs [T, PIXEL_INPUTS, h, w]."""
        return decode_maps(self.network.evaluate(theta, self.network.gain * theta["z"], inputs))


def _scale_slopes(theta: Params) -> Params:
    """Scale the slopes of the maps of fields with parameters [T, ...] by INITIAL_SLOPE_GAIN."""
    factor = theta["out.shift"].new_tensor([INITIAL_SLOPE_GAIN] * CHANNELS[0] + [1.0] * sum(CHANNELS[1:]))
    last_layer = {name: value for name, value in theta.items() if name.startswith("out.")}
    return theta | {name: factor.reshape(-1, *[1] * (value.ndim - 2)) * value for name, value in last_layer.items()}


def _apply_polish(theta: Params, maps: Maps, height: Tensor | None = None) -> Params:
    """Shift the roughness of fields with maps [T, C, h, w] to the roughness that a sharp highlight shows.

    Args:
        theta: the parameters of the fields, and `shown` [T].
        maps: their maps.
        height: heights of cameras in half sides of the patch, [T, 1], 0 where they are not known; None if none is.
    """
    shown = theta["shown"]
    true_roughness = shown if height is None else scale_roughness(shown, height[:, 0])
    shift = roughness_shift(shown, maps, true_roughness) / (1 - FULL_SHARE)
    roughness = torch.arange(sum(CHANNELS), device=shift.device) == ROUGHNESS_CHANNEL
    kept = {key: value for key, value in theta.items() if key != "shown"}
    return kept | {"out.shift": theta["out.shift"] + shift[:, None] * roughness}

"""Non-stationary svBRDFs from one photograph whose General reads features of VGG-16: the fields, losses and fits."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.features import feature_conditions
from metapp.appearance.flash import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, blots
from metapp.apps.svbrdf_nonstationary.coded_maps import BLOTS_WEIGHT, MAPS_WEIGHT, PHOTO_WEIGHT, FromPhoto
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
from metapp.apps.svbrdf_nonstationary.pretrained.polish import roughness_shift
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import add_decoder, join_encoder, select_reader
from metapp.networks.field import LocalField

PART_WEIGHTS = (1.0, 1.0, 4.0, 10.0)  # of the differences of maps, in the order of PARTS; pictures ignore normals
# The predicted slope that is halved, and the gain of all slopes: chosen by validation materials
HALVED_SLOPE, SLOPE_GAIN = 0.1, 1.5
LIKELIHOOD_WEIGHT = 0.03  # of the likelihood of predicted errors, which moves nothing but these
INITIAL_SLOPE_GAIN = 0.05  # of untrained fields, whose maps are nearly flat
PATCH_KEYS = ("overview", "highlight", "guess", "code", "flash")  # what `describe_patch` returns
DECODER_PREFIX = "decoder."
FULL_PREFIX = "full."  # of names of the parameters of the field of the recipe "full"
FULL_SHARE = 0.5  # of that field in diffuse colour, roughness and specular colour; slopes are of the other field


class MeanField(LocalField):
    """A field beside the field of the recipe "full": the mean of both, but slopes of the first alone.

    Networks with other features and other training materials make other errors, which the mean lowers. `z` holds the
    codes of both fields, that of the first field first.
    """

    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters of both fields, [count, ...] each."""
        full = FULL_APP.network._replace(rows=self.rows, columns=self.columns)
        own, other = super().init(rng, count), full.init(rng, count)
        z = torch.cat([own["z"], other.pop("z")], 1)
        return own | {f"{FULL_PREFIX}{key}": value for key, value in other.items()} | {"z": z}

    def decoded(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """Evaluate the mean of both fields at texels, [T, outputs, h, w].

        Args:
            theta: the parameters of both.
            code: both codes at the texels, [T, 2 codes, h, w].
            places: the inputs of the texels, [T, inputs, h, w].
        """
        return self.mean(*self.both(theta, code, places))

    def both(self, theta: Params, code: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate each of both fields at texels, [T, outputs, h, w] each; see :meth:`decoded`."""
        full = {key.removeprefix(FULL_PREFIX): value for key, value in theta.items() if key.startswith(FULL_PREFIX)}
        own = super().decoded(theta, code[:, : self.code], places)
        return own, FULL_APP.network.decoded(full, code[:, self.code :], places)

    def mean(self, own: Tensor, full: Tensor) -> Tensor:
        """Return the mean of the outputs of both fields [T, outputs, h, w]; slopes are those of the first."""
        return torch.cat(
            [own[:, : CHANNELS[0]], torch.lerp(own[:, CHANNELS[0] :], full[:, CHANNELS[0] :], FULL_SHARE)], 1
        )


@dataclass(frozen=True)
class FromFeatures(FromPhoto):
    """Fits of one photograph that begin at General's maps by features of VGG-16.

    General draws no relief that a photograph does not show. Beside `maps` a training task may hold `known` [4], weights
    of the loss of the maps in the order of PARTS, 0 where a map is made up.
    """

    network: MeanField = field()

    @property
    @override
    def read_size(self) -> int:
        return FINEST_PX

    @override
    def conditions(self, device: torch.device | None = None) -> dict[str, str]:
        """Return the features of VGG, and that they are in bfloat16 where CPUs are made for it."""
        return feature_conditions(device)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Add the weights of the losses of maps, `known` [4]: those that the task states, else ones."""
        known = task.data.get("known", torch.ones(len(PARTS)))
        return super().prepare(task) | {"known": known.float()}

    def init(self, rng: Generator, count: int) -> Params:
        """Draw parameters of maps that are nearly flat, as steps of fits leave normals as they are."""
        return _flatten(super().init(rng, count)) | unknown_deviation(count, rng.device)

    def init_encoder(self, rng: Generator) -> Params:
        """Draw the decoder and the first field, whose maps are nearly flat: training begins without relief."""
        own = LocalField(*self.network)
        return join_encoder(init_decoder(rng, own.code), _flatten(own.init(rng, 1)), ("z",))

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Draw windows of half the field's side of augmented materials, photographed anew."""
        fine, known = (tasks.data[key][tasks.rows].float() for key in ("fine", "known"))
        return tasks.make_variants(draw_variants(fine, known, self.network.height // 2, rng))

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the photographs; of windows also the inputs of the field and what is known of the whole patch."""
        window = {key: tasks.data[key][tasks.rows] for key in ("inputs", *PATCH_KEYS) if key in tasks.data}
        return super().condition(tasks, rng) | window

    def read(self, reader: Params, photos: Tensor, place: Tensor | None = None, patch: Params | None = None) -> Params:
        """Return what `read_photos` reads, with codes and flash in the units of the fields' parameters."""
        own = read_photos(reader, photos, place, patch)
        return own | {key: own[key] / self.network.gain for key in ("z", "flash")}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Return parameters of both fields; windows, which training alone sees, have a code in each of their pixels."""
        full = full_encoder(condition["photo"].device).items()
        beside = {
            key.replace(DECODER_PREFIX, DECODER_PREFIX + FULL_PREFIX): value
            for key, value in full
            if key.startswith(DECODER_PREFIX)
        }
        if "inputs" not in condition:
            theta = super().encode(encoder | beside, condition)
            return _apply_polish(theta, self.maps_of(theta, condition["photo"]))
        place, patch = condition["inputs"][:, -2:], {key: condition[key] for key in PATCH_KEYS if key in condition}
        own = self.read(select_reader(encoder), condition["photo"], place, patch or None)
        theta = add_decoder(own, encoder | beside)
        return _apply_polish(theta, self._made_of(theta, condition["inputs"]))

    def postprocess(self, theta: Params) -> Params:
        """Return fits without predicted errors, which training alone reads."""
        return {key: value for key, value in theta.items() if key != "deviation"}

    def maps_from(self, raw: Tensor) -> Maps:
        """Return the maps of outputs of fields, with slopes s changed to SLOPE_GAIN s |s|^2 / (|s|^2 + HALVED_SLOPE^2).

        The network makes conditional means; the mean difference of normals asks for medians, which are flat where a
        photograph tells little, and steeper where it tells a lot.
        """
        slopes, rest = raw.split((CHANNELS[0], sum(CHANNELS[1:])), 1)
        square = slopes.square().sum(1, keepdim=True)
        return super().maps_from(torch.cat([SLOPE_GAIN * square / (square + HALVED_SLOPE**2) * slopes, rest], 1))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the difference from the photograph, [T], which moves the code of "full" and the flash alone.

        So normals stay those of General: a photograph under one light says less of them than General has read.
        """
        fixed = {key: value.detach() for key, value in theta.items()}
        own, full = self.network.both(fixed, self.network.gain * theta["z"], pixel_inputs(batch["photo"]))
        return self.photo_difference(theta, self.maps_from(self.network.mean(own.detach(), full)), batch, learned)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Return the difference of the maps and of their radiance under random lights, [T]; made-up maps do not count.

        Nothing asks for normals as steep as the truth's, and pictures are of the true ones: normals learn from their
        squared error alone, over the deviation that General predicts, whose minimum is the conditional mean, flat where
        the photograph does not tell.
        """
        inputs = batch["inputs"] if "inputs" in batch else pixel_inputs(batch["photo"])
        known, target = batch["known"], unpack_maps(batch["maps"])
        batch = batch | {"place": inputs[:, -2:]}
        maps = self._made_of(theta, inputs)
        apart = map_differences(maps, target)
        scale = laplace_scales(theta)[:, -1:].detach()
        squared = apart[-1].square() / scale.repeat_interleave(4, -1).repeat_interleave(4, -2)
        off = torch.stack([part.abs().mean((1, 2, 3)) for part in (*apart[:-1], squared)], 1)
        wanted = (off * known * off.new_tensor(PART_WEIGHTS)).sum(1)
        hidden = known[:, 0] * blots(apart[0], batch["photo"])
        shown = known[:, 1:3, None, None, None] > 0  # of what is made up, pictures say nothing
        specular = torch.where(shown[:, 0], maps.specular, target.specular)
        roughness = torch.where(shown[:, 1], maps.roughness, target.roughness)
        # and nothing of normals: the median of a highlight lies at a slope, though the mean slope be 0
        seen = Maps(maps.diffuse, specular, roughness, target.normal)
        logs, references = (self.log_radiance(each, batch["pairs"], batch["place"]) for each in (seen, target))
        pictures = (logs - references).abs().mean((1, 2, 3, 4))
        loss = known[:, 3] * (pictures + PHOTO_WEIGHT * self.photo_difference(theta, seen, batch, {}))
        likelihood = negative_log_likelihood(apart, theta) * known.amin(1)
        return loss + MAPS_WEIGHT * wanted + BLOTS_WEIGHT * hidden + LIKELIHOOD_WEIGHT * likelihood

    def _made_of(self, theta: Params, inputs: Tensor) -> Maps:
        """Return the maps [T, C, h, w] of a code in each texel, for inputs of the fields [T, PIXEL_INPUTS, h, w]."""
        return decode_maps(self.network.decoded(theta, self.network.gain * theta["z"], inputs))


def _flatten(theta: Params) -> Params:
    """Scale the slopes of the maps of fields with parameters [T, ...] by INITIAL_SLOPE_GAIN."""
    factor = theta["out.shift"].new_tensor([INITIAL_SLOPE_GAIN] * CHANNELS[0] + [1.0] * sum(CHANNELS[1:]))
    last = {name: value for name, value in theta.items() if name.startswith("out.")}
    return theta | {name: factor.reshape(-1, *[1] * (value.ndim - 2)) * value for name, value in last.items()}


def _apply_polish(theta: Params, maps: Maps) -> Params:
    """Shift the roughness of fields with maps [T, C, h, w] to that which a sharp highlight shows."""
    shift = roughness_shift(theta["shown"], maps) / (1 - FULL_SHARE)
    roughness = torch.arange(sum(CHANNELS), device=shift.device) == ROUGHNESS_CHANNEL
    rest = {key: value for key, value in theta.items() if key != "shown"}
    return rest | {"out.shift": theta["out.shift"] + shift[:, None] * roughness}

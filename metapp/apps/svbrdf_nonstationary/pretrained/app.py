"""Non-stationary svBRDFs whose General reads features of VGG-16, and how it is trained on real and drawn materials."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Generator, Tensor

from metapp.appearance.features import describe_features, describe_precision
from metapp.appearance.flash import Maps, unpack
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, blots
from metapp.apps.svbrdf_nonstationary.coded_maps import BLOTS_WEIGHT, MAPS_WEIGHT, PHOTO_WEIGHT, FromPhoto
from metapp.apps.svbrdf_nonstationary.maps import RAW, ROUGHNESS, decoded, differences, inputs_of
from metapp.apps.svbrdf_nonstationary.pretrained.augmentation import variants
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
from metapp.apps.svbrdf_nonstationary.pretrained.polish import raw_shift
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.coded import encoder_of, reader_of, with_decoder
from metapp.networks.field import LocalField

WEIGHTS = (1.0, 1.0, 4.0, 10.0)  # of the maps, in the order of PARTS; pictures say nothing of normals
SHALLOW, STEEPER = 0.1, 1.5  # the slope that is halved, how many times as steep others are: by validation materials
LIKELIHOOD = 0.03  # weight of the likelihood of the predicted errors, which moves nothing but these
FLAT = 0.05  # of the slopes of untrained fields
OF_PATCH = ("overview", "highlight", "guess", "code", "flash")  # what is read of all of a patch
DECODER = "decoder."
BESIDE = "full."  # before the names of the parameters of General's field by "full"
SHARE = 0.5  # of that field in diffuse colour, roughness and specular colour; it has none in slopes


class MeanField(LocalField):
    """A field and that of General by "full", each with its own code; the mean of both, but of slopes its own.

    Networks of other features and other training materials err differently. `z` holds both codes, its own first.
    """

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of both fields: each tensor [count, ...]."""
        full = FULL_APP.network._replace(rows=self.rows, columns=self.columns)
        own, other = super().init(rng, count), full.init(rng, count)
        z = torch.cat([own["z"], other.pop("z")], 1)
        return own | {f"{BESIDE}{key}": value for key, value in other.items()} | {"z": z}

    def decoded(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """The mean at texels with both codes [T, 2 codes, h, w] and `places` [T, inputs, h, w]: [T, outputs, h, w]."""
        return self.mean(*self.both(theta, code, places))

    def both(self, theta: Params, code: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Each field's outputs, as of `decoded`."""
        full = {key.removeprefix(BESIDE): value for key, value in theta.items() if key.startswith(BESIDE)}
        own = super().decoded(theta, code[:, : self.code], places)
        return own, FULL_APP.network.decoded(full, code[:, self.code :], places)

    def mean(self, own: Tensor, full: Tensor) -> Tensor:
        """The mean of both fields' outputs [T, outputs, h, w]."""
        return torch.cat([own[:, : RAW[0]], torch.lerp(own[:, RAW[0] :], full[:, RAW[0] :], SHARE)], 1)


@dataclass(frozen=True)
class FromFeatures(FromPhoto):
    """The same materials and fits; General reads features of VGG-16 and draws no relief that a photograph hides.

    Beside `maps` a training task may hold `known` [4], weights of the loss of the maps, in the order of PARTS, 0 where
    it is made up.
    """

    network: MeanField = field()

    @property
    def read_size(self) -> int:
        """That of the finest photographs."""
        return FINEST_PX

    def conditions(self) -> dict[str, str]:
        """The features, which a checkpoint's encoder needs."""
        return {"features": describe_features()}

    def precision(self, device: torch.device) -> str:
        """VGG in bfloat16 on CPUs that are made for it."""
        return describe_precision(device)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """The same, and `known`, that of drawn materials if a task has none."""
        known = task.data.get("known", torch.ones(len(PARTS)))
        return super().prepare(task) | {"known": known.float()}

    def init(self, rng: Generator, count: int) -> Params:
        """Of maps that are nearly flat: fits hold their normals."""
        return _flat(super().init(rng, count)) | unknown_deviation(count, rng.device)

    def init_encoder(self, rng: Generator) -> Params:
        """Its own field, of maps that are nearly flat: training begins where nothing is known of relief."""
        own = LocalField(*self.network)
        return encoder_of(init_decoder(rng, own.code), _flat(own.init(rng, 1)), ("z",))

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Windows of the same materials of half the field's side, photographed anew."""
        fine, known = (tasks.data[key][tasks.rows].float() for key in ("fine", "known"))
        return tasks.variants(variants(fine, known, self.network.height // 2, rng))

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """The photographs; of windows the field's inputs, too, which hold their places, and statistics of the whole."""
        window = {key: tasks.data[key][tasks.rows] for key in ("inputs", *OF_PATCH) if key in tasks.data}
        return super().condition(tasks, rng) | window

    def read(self, reader: Params, photos: Tensor, place: Tensor | None = None, patch: Params | None = None) -> Params:
        """Both codes and the flash in the network's units, and the deviations, as of `read_photos`."""
        own = read_photos(reader, photos, place, patch)
        return own | {key: own[key] / self.network.gain for key in ("z", "flash")}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """With the field of "full"; of windows, which training sees, a code in each of their pixels."""
        full = full_encoder(condition["photo"].device).items()
        beside = {key.replace(DECODER, DECODER + BESIDE): value for key, value in full if key.startswith(DECODER)}
        if "inputs" not in condition:
            theta = super().encode(encoder | beside, condition)
            return _polished(theta, self.maps_of(theta, condition["photo"]))
        place, patch = condition["inputs"][:, -2:], {key: condition[key] for key in OF_PATCH if key in condition}
        own = self.read(reader_of(encoder), condition["photo"], place, patch or None)
        theta = with_decoder(own, encoder | beside)
        return _polished(theta, self._made_of(theta, condition["inputs"]))

    def postprocess(self, theta: Params) -> Params:
        """Without the deviations, which training alone reads."""
        return {key: value for key, value in theta.items() if key != "deviation"}

    def maps_from(self, raw: Tensor) -> Maps:
        """Slopes s are s |s|^2 / (|s|^2 + SHALLOW^2) times STEEPER.

        The network makes conditional means; the mean difference of normals asks for medians, which are flat where a
        photograph tells little, and steeper where it tells a lot.
        """
        slopes, rest = raw.split((RAW[0], sum(RAW[1:])), 1)
        square = slopes.square().sum(1, keepdim=True)
        return super().maps_from(torch.cat([STEEPER * square / (square + SHALLOW**2) * slopes, rest], 1))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the photograph, which moves the code of "full" and the flash alone, [T].

        So normals stay those of General: a photograph under one light says less of them than General has read.
        """
        fixed = {key: value.detach() for key, value in theta.items()}
        own, full = self.network.both(fixed, self.network.gain * theta["z"], inputs_of(batch["photo"]))
        return self.photo_difference(theta, self.maps_from(self.network.mean(own.detach(), full)), batch, learned)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Of the maps and their radiance under any light, [T]; made-up maps count nothing.

        Nothing asks for normals as steep as the truth's, and pictures are of the true ones: normals learn from their
        squared error alone, over the deviation that General predicts, whose minimum is the conditional mean, flat where
        the photograph does not tell.
        """
        inputs = batch["inputs"] if "inputs" in batch else inputs_of(batch["photo"])
        known, target = batch["known"], unpack(batch["maps"])
        batch = batch | {"place": inputs[:, -2:]}
        maps = self._made_of(theta, inputs)
        apart = differences(maps, target)
        scale = laplace_scales(theta)[:, -1:].detach()
        squared = apart[-1].square() / scale.repeat_interleave(4, -1).repeat_interleave(4, -2)
        off = torch.stack([part.abs().mean((1, 2, 3)) for part in (*apart[:-1], squared)], 1)
        wanted = (off * known * off.new_tensor(WEIGHTS)).sum(1)
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
        return loss + MAPS_WEIGHT * wanted + BLOTS_WEIGHT * hidden + LIKELIHOOD * likelihood

    def _made_of(self, theta: Params, inputs: Tensor) -> Maps:
        """The maps [T, C, h, w] of a code in each texel, of the field's inputs [T, 8, h, w]."""
        return decoded(self.network.decoded(theta, self.network.gain * theta["z"], inputs))


def _flat(theta: Params) -> Params:
    """The same parameters of fields [T, ...], of maps whose slopes are FLAT times as steep."""
    factor = theta["out.shift"].new_tensor([FLAT] * RAW[0] + [1.0] * sum(RAW[1:]))
    last = {name: value for name, value in theta.items() if name.startswith("out.")}
    return theta | {name: factor.reshape(-1, *[1] * (value.ndim - 2)) * value for name, value in last.items()}


def _polished(theta: Params, maps: Maps) -> Params:
    """The parameters of fields with maps [T, C, h, w], their roughness shifted to that of the highlight, if sharp."""
    shift = raw_shift(theta["shown"], maps) / (1 - SHARE)
    roughness = torch.arange(sum(RAW), device=shift.device) == ROUGHNESS
    rest = {key: value for key, value in theta.items() if key != "shown"}
    return rest | {"out.shift": theta["out.shift"] + shift[:, None] * roughness}

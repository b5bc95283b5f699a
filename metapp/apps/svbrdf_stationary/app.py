"""Stationary svBRDFs: a network from noise to maps that look as a flash photo under its light (paper section 4.1.3)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, pad

from metapp.appearance.features import amplitudes, distance, gram, moments
from metapp.appearance.flash import (
    GAMMA,
    STATISTICS_AT,
    Maps,
    camera,
    expose,
    flash_position,
    normal_from_height,
    positions,
    relightings,
    render,
    statistics,
)
from metapp.appearance.highlight import evenly_lit, gloss
from metapp.apps.exemplar.app import ExemplarApp
from metapp.apps.svbrdf_stationary.windows import (
    GRID,
    crop_window,
    fade_weights,
    grams_in_windows,
    grams_of_tasks,
    mask_ring,
)
from metapp.learning.app import ErrorMeasure
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec
from metapp.networks.layout import astray

DRAWN_WINDOWS = 3
POOLED_PX = 8
SPECTRUM = 0.3  # the spectra's weight in the loss
RINGS = ((0.0, 0.2), (0.2, 0.8), (0.8, 3.0))  # squared distances from the centre, of half the photo's side
BRIGHTER = 2.0  # further weight in the outer loss of pooled pictures, which hold the shape of the highlight
TRUTH = 3.0  # weight in the outer loss of how far the maps' statistics are from the truth's
GLOSS = 0.05  # further weight in the outer loss of how far specular and roughness are from the truth's, in logits
LIKELY = 0.05  # the same where the truth is unknown, of how unusual specular and roughness are
OF_ROUGHNESS = 0.4  # varies more between materials than specular does
COLOUR = 3.0  # weight in the loss of how much more or less colours vary than in the photo
# A highlight says gloss where the lobe is so much of what is reflected below the flash, 0 to 1, and is no wider.
EVIDENT, NARROW = (0.6, 0.8), 0.5
RELIEF = 1 / 32  # widths of the photo a unit of the network's output, as height
FALLOFF = 1.0


class SvbrdfStationary(ExemplarApp):
    """One flash photograph of a flat stationary material a task.

    The light depends on the place, so statistics are compared window by window: those of a window of the
    picture with those of the same window of the photo. The generator does not know the place, which keeps highlights
    out of the maps.
    """

    name = "svbrdf_stationary"
    error_measure = ErrorMeasure(
        "relative L1 distance of Gram matrices in 9 windows, mean over windows, taps and generated materials"
    )
    described = ("gram", "spectrum")
    tensors: ClassVar = {
        "image": TensorSpec((3, "S", "S"), "uint8"),
        "relit": TensorSpec((3, 3, "R", "R"), "uint8", optional=True),
        "truth": TensorSpec((3, 2, 6), low=0, high=1, optional=True),
    }

    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Of photos [B, 3, h, w] of the size of an octave.

        Gram matrices in all windows `gram0`... [B, N, C, C], spectra `spectrum0`..., `pooled` [B, 3, 8, 8], `light`
        [B, 3] position of the flash, `chroma` [B, 2], how much colours vary, `shine` [B, 3], estimates of the highlight
        of specular and roughness and how clearly, `summary`.
        """
        maps, light = self.features(exemplars, octave), self.light_of(exemplars)
        described = {"light": light, "pooled": adaptive_avg_pool2d(exemplars, POOLED_PX)}
        described |= {"chroma": _chroma(exemplars), "shine": _shine(exemplars, light)}
        for i, each in enumerate(maps):
            described[f"gram{i}"] = grams_in_windows(each, range(GRID * GRID))
            described[f"spectrum{i}"] = amplitudes(each)
        return described | {"summary": self.summary(maps, octave)}

    def summary(self, maps: list[Tensor], octave: int) -> Tensor:
        """Means and root mean squares of features where the light is strong, at medium strength, and weak."""
        rings = [[mask_ring(each, low, high) for each in self.parts(maps, octave)] for low, high in RINGS]
        return torch.cat([moments(ring) for ring in rings], 1)

    def light_of(self, photos: Tensor) -> Tensor:
        """The position of the flash of photos [B, 3, h, w], [B, 3]."""
        place = flash_position(photos)
        height = camera(dtype=photos.dtype, device=photos.device)[2].expand(len(photos), 1)
        return torch.cat([place.to(photos), height], 1)

    def summary_size(self) -> int:
        return len(RINGS) * super().summary_size()

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """As for all exemplars, and, if the task has them, `relit` uint8 [3, 3, S, S] and `truth` [3, 2, 6]."""
        return super().prepare(task) | {key: task.data[key] for key in ("relit", "truth") if key in task.data}

    def carried(self, tasks: Tasks, channels: Tensor) -> dict[str, Tensor]:
        if "truth" not in tasks.data:
            return {}
        order = torch.cat([channels, torch.arange(3, 6, device=channels.device).expand(len(channels), -1)], 1)
        truth = tasks.data["truth"][tasks.rows]
        return {"truth": truth.gather(-1, order[:, None, None].expand(truth.shape))}

    def init(self, rng: Generator, count: int) -> Params:
        theta = super().init(rng, count)
        return theta | {"gloss": torch.zeros(count, 2, device=rng.device)} if self.prior else theta

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return super().condition(tasks, rng) | {"shine": tasks.data["shine"][tasks.rows]}

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """As for all exemplars, and if fits have a prior, `gloss` [T, 2], its expected value."""
        theta = super().encode(encoder, condition)
        return self._as_glossy(theta, condition["shine"]) if self.prior else theta

    def _as_glossy(self, theta: Params, shine: Tensor) -> Params:
        """Theta whose maps have the mean gloss that a clear highlight says, else General's, and that as `gloss`."""
        expected, sure = self._expected(theta), shine[:, :1]
        change = sure * (shine[:, 1:] - expected)
        offset = self.network.offset
        return theta | {"gloss": expected + change, offset: theta[offset] + pad(change, (3, 1))}

    @torch.no_grad()
    def _expected(self, theta: Params) -> Tensor:
        """Means of specular and roughness [T, 2] as the network makes them, of a small picture from the same noise."""
        coarsest = self.octaves - 1
        noise = self.fixed_noise(theta["z"], 1, octave=coarsest)
        maps = self.generate(theta, noise, coarsest)
        return torch.stack([part.mean((1, 2, 3, 4)) for part in _raw_gloss(maps.specular, maps.roughness)], -1)

    def maps(self, theta: Params, noise: Tensor, octave: int = 0) -> tuple[Maps, Tensor]:
        """Maps of materials [T, B, ...] from noise [T, B, C, H, W], and their height [T, B, 1, H, W] in texels."""
        raw = self.made(theta, noise, octave)
        diffuse = torch.sigmoid(raw[:, :, :3]) ** 2.2  # about evenly spread for the eye
        specular = torch.sigmoid(raw[:, :, 3:4] - 3)  # about 0.05 at first, as most dielectrics
        roughness = 0.1 + 0.9 * torch.sigmoid(raw[:, :, 4:5])
        height = RELIEF * (self.width >> octave) * raw[:, :, 5:]
        return Maps(diffuse, specular, roughness, normal_from_height(height)), height

    def photograph(self, maps: Maps, light: Tensor, view: Tensor) -> Tensor:
        """Display values [..., 3, H, W] of maps under a flash; light and view [..., 3]."""
        place = positions(*maps.diffuse.shape[-2:], dtype=light.dtype, device=light.device)
        return expose(render(maps, place, light, view, falloff=FALLOFF))

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`noise` for `count` materials of each task, some of the windows and the photo's statistics there."""
        drawn = torch.randperm(GRID * GRID, generator=rng, device=rng.device)[:DRAWN_WINDOWS].expand(len(tasks), -1)
        noise = self.noise(rng, len(tasks), count, octave=self.octave(tasks.data))
        return {"noise": noise, "windows": drawn} | self._targets(tasks, drawn)

    def _targets(self, tasks: Tasks, windows: Tensor) -> Batch:
        rows = tasks.rows
        named = [key for key in tasks.data if key in ("light", "pooled", "chroma", "detail", "truth")]
        targets = {key: tasks.data[key][rows] for key in named}
        for i in range(self.maps_from(self.octave(tasks.data))):
            targets[f"spectrum{i}"] = tasks.data[f"spectrum{i}"][rows]
            targets[f"gram{i}"] = tasks.data[f"gram{i}"][rows[:, None], windows]
        return targets

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Distance of Gram matrices in windows, of the features' spectra, and of the pooled pictures, [T].

        And how unusual the maps are, by `prior`.
        """
        maps = self.generate(theta, batch["noise"], self.octave(batch))
        loss = torch.stack(list(self._distances(theta, maps, batch).values())).sum(0)
        return loss + self.prior * _unusual(maps, theta["gloss"]) if self.prior else loss

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The same, but how far the maps are from the truth, or how unusual if that is unknown, [T].

        Without it General comes to explain all photographs by one bright, rough, specular surface without colour: one
        flash photo does not tell diffuse, specular and relief apart.
        """
        octave = self.octave(batch)
        maps = self.generate(theta, batch["noise"], octave)
        distances = self._distances(theta, maps, batch)
        loss = torch.stack(list(distances.values())).sum(0) + BRIGHTER * distances["pooled"]
        if "truth" not in batch:
            return loss + LIKELY * _unusual(maps, maps.diffuse.new_zeros(len(maps.diffuse), 2))
        level = sum(self.width >> octave < size for size in STATISTICS_AT[:-1])
        truth = batch["truth"][:, level]
        specular, roughness = (truth[:, 0, 3] ** GAMMA).clamp_min(1e-3), truth[:, 0, 4].clamp(0.12, 0.98)
        pairs = zip(_raw_gloss(maps.specular, maps.roughness), _raw_gloss(specular, roughness), strict=True)
        # where no gradient vanishes
        unlike = torch.stack([(part.mean((1, 2, 3, 4)) - wanted).abs() for part, wanted in pairs]).sum(0)
        return loss + TRUTH * (statistics(maps) - truth[:, None]).abs().mean((1, 2, 3)) + GLOSS * unlike

    def _distances(self, theta: Params, maps: Maps, batch: Batch) -> dict[str, Tensor]:
        pictures = self.photograph(maps, batch["light"][:, None], batch["light"][:, None])
        distances = self._distances_of(pictures, batch, cropped=True)
        if self.has_layout:
            colours = (
                _chroma(pictures.flatten(0, 1)).unflatten(0, pictures.shape[:2]) - batch["chroma"][:, None]
            ).abs()
            distances["colour"] = COLOUR * colours.mean((1, 2))
            even, times = evenly_lit(pictures, batch["light"][:, None]), self.layout_ratio(self.octave(batch))
            distances["astray"] = astray(theta, batch["noise"], even, times)
            distances["softness"] = self.softness(pictures, batch)
        return distances

    def evenly_lit(self, pictures: Tensor, described: Batch) -> Tensor:
        return evenly_lit(pictures, described["light"])

    def look(self, answer: Maps | Tensor, described: Batch) -> Tensor:
        light = described["light"][:, None]
        return self.photograph(answer, light, light) if isinstance(answer, Maps) else answer

    def generate(self, theta: Params, noise: Tensor, octave: int = 0) -> Maps:
        return self.maps(theta, noise, octave)[0]

    def _distances_of(self, pictures: Tensor, batch: Batch, *, cropped: bool = False) -> dict[str, Tensor]:
        """Of pictures [T, S, 3, H, W]; `cropped`: of their finest octave the first window alone, not its spectra."""
        leading, flat, octave = pictures.shape[:2], pictures.flatten(0, 1), self.octave(batch)
        pooled = adaptive_avg_pool2d(flat, POOLED_PX).unflatten(0, leading)
        windows = batch["windows"].tolist()
        first = [own[0] for own in windows for _ in range(leading[1])]
        cropped = cropped and octave == 0 and self.octaves > 1
        crop = (lambda images: torch.stack(list(map(crop_window, images, first)))) if cropped else None
        found = self.features(flat, octave, crop)
        whole = self.maps_from(1) if cropped else len(found)
        grams, spectra = [], []
        for i, maps in enumerate(found):
            wanted = batch[f"gram{i}"][:, None]
            if i < whole:
                spectra.append(distance([amplitudes(maps).unflatten(0, leading)], [batch[f"spectrum{i}"][:, None]]))
                made = grams_of_tasks(maps.unflatten(0, leading), windows)
            else:
                made, wanted = gram(maps * fade_weights(maps)).unflatten(0, leading)[:, :, None], wanted[:, :, :1]
            grams.append(distance([made], [wanted]).mean((1, 2)))
        return {
            "gram": torch.stack(grams).mean(0),
            "spectrum": SPECTRUM * torch.stack(spectra).mean((0, 2)),
            "pooled": (pooled - batch["pooled"][:, None]).abs().mean((1, 2, 3, 4)),
        }

    @torch.no_grad()
    def errors_of(self, answer: Maps | Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of maps [T, B, ...] of the exemplar's size, or of photographs [T, B, 3, H, W] of them, sRGB in [0, 1].

        `relit` is the error under other lights and from elsewhere, if the data set has references of that.
        Photographs are under the exemplar's light and have none.
        """
        every = torch.arange(GRID * GRID, device=tasks.rows.device).expand(len(tasks), -1)
        batch = {"windows": every} | self._targets(tasks, every)
        distances = self._distances_of(self.look(answer, batch), batch)
        errors = {
            "error": distances["gram"],
            "spectrum": distances["spectrum"] / SPECTRUM,
            "brightness": distances["pooled"],
        }
        if "relit" in tasks.data and isinstance(answer, Maps):
            errors["relit"] = self._relit(answer, tasks.data["relit"][tasks.rows])
        return errors

    def _relit(self, maps: Maps, references: Tensor) -> Tensor:
        errors = []
        for i, (light, view) in enumerate(relightings(device=references.device).values()):
            pictures = self.photograph(maps, light, view)
            target = self.exemplar(references[:, i].float() / 255)
            grams = [
                [grams_in_windows(part, range(GRID * GRID)) for part in self.features(images, 0)]
                for images in (pictures.flatten(0, 1), target)
            ]
            made = [part.unflatten(0, pictures.shape[:2]) for part in grams[0]]
            errors.append(distance(made, [part[:, None] for part in grams[1]]).mean((1, 2)))
        return torch.stack(errors).mean(0)


def _raw_gloss(specular: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """The network's output for specular and roughness of any shape, before any range was imposed."""
    ends = ((specular, 1e-9), ((roughness - 0.1) / 0.9, 1e-6))  # torch's logit has one eps for both ends
    # no float32 is 1 - 1e-9
    raw = [part.clamp_min(eps).log() - torch.log1p(-part.clamp_max(1 - 1e-6)) for part, eps in ends]
    return raw[0] + 3, raw[1]


def _chroma(photos: Tensor) -> Tensor:
    """Standard deviations [B, 2] of red less green and of yellow less blue, of photos [B, 3, H, W]."""
    red, green, blue = photos.unbind(1)
    opponents = torch.stack([red - green, (red + green) / 2 - blue], 1)
    return (opponents.var((2, 3)) + 1e-6).sqrt()


def _shine(photos: Tensor, light: Tensor) -> Tensor:
    """The highlight's confidence in the gloss, 0 to 1, and specular and roughness as networks make them, [B, 3]."""
    highlight = gloss(avg_pool2d(photos, 2), light)
    low, high = EVIDENT
    sure = ((highlight.contrast - low) / (high - low)).clamp(0, 1) * (highlight.roughness < NARROW)
    made = _raw_gloss(highlight.specular.clamp(0.01, 0.5), highlight.roughness.clamp(0.12, 0.98))
    return torch.stack([sure, *made], 1)


def _unusual(maps: Maps, expected: Tensor) -> Tensor:
    """Mean squares of how far specular and, weighted, roughness are from their expected values [T, 2], [T]."""
    expected = expected.detach() + 0 * expected  # a parameter that no step moves
    specular, roughness = (
        (part - mean[:, None, None, None, None]).square().mean((1, 2, 3, 4))
        for part, mean in zip(_raw_gloss(maps.specular, maps.roughness), expected.unbind(1), strict=True)
    )
    return specular + OF_ROUGHNESS * roughness

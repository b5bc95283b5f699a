"""What is known of a flash photograph: statistics window by window, its light, and what its highlight says of gloss."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d

from metapp.appearance.features import amplitude_spectrum, gram, moments, statistics_distance
from metapp.appearance.flash import (
    Maps,
    camera_position,
    estimate_flash_position,
    radiance_to_display,
    relighting_positions,
    render_maps,
    texel_positions,
)
from metapp.appearance.highlight import estimate_gloss, remove_shading
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.svbrdf_stationary.windows import (
    WINDOWS_PER_SIDE,
    crop_window,
    fade_weights,
    grams_in_windows,
    grams_of_tasks,
    mask_ring,
)
from metapp.learning.task import Batch, Tasks

POOLED_PX = 8
SPECTRUM_WEIGHT = 0.3  # the spectra's weight in the loss
RING_BOUNDS = ((0.0, 0.2), (0.2, 0.8), (0.8, 3.0))  # squared distances from the centre, of half the photo's side
# A highlight says gloss where the lobe is so much of what is reflected below the flash, 0 to 1, and is no wider.
LOBE_SHARES, MAX_LOBE_ROUGHNESS = (0.6, 0.8), 0.5
FLASH_FALLOFF = 1.0


class FlashStatistics(Statistics):
    """Statistics of pictures under the flash of a photograph.

    The light depends on the place, so statistics are compared window by window: those of a window of the picture with
    those of the same window of the photo.
    """

    names = ("gram", "spectrum")

    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Return what is known of photos [B, 3, h, w] of the size of an octave.

        Gram matrices in all windows `gram0`... [B, N, C, C], spectra `spectrum0`..., `pooled` [B, 3, 8, 8], `light`
        [B, 3] position of the flash, `chroma` [B, 2], how much colours vary, `shine` [B, 3], estimates of the highlight
        of specular and roughness and how clearly, `summary`.
        """
        maps, light = self.compute_features(exemplars, octave), self.find_light(exemplars)
        described = {"light": light, "pooled": adaptive_avg_pool2d(exemplars, POOLED_PX)}
        described |= {"chroma": chroma_deviations(exemplars), "shine": _shine(exemplars, light)}
        for i, each in enumerate(maps):
            described[f"gram{i}"] = grams_in_windows(each, range(WINDOWS_PER_SIDE * WINDOWS_PER_SIDE))
            described[f"spectrum{i}"] = amplitude_spectrum(each)
        return described | {"summary": self.summarise(maps, octave)}

    def summarise(self, maps: list[Tensor], octave: int) -> Tensor:
        """Return means and root mean squares of features where the light is strong, at medium strength, and weak."""
        filled = self.octaves.fill(maps, octave)
        rings = [[mask_ring(each, low, high) for each in filled] for low, high in RING_BOUNDS]
        return torch.cat([moments(ring) for ring in rings], 1)

    @property
    def summary_size(self) -> int:
        return len(RING_BOUNDS) * super().summary_size

    def find_light(self, photos: Tensor) -> Tensor:
        """Find the position of the flash of photos [B, 3, h, w], [B, 3]."""
        place = estimate_flash_position(photos)
        height = camera_position(dtype=photos.dtype, device=photos.device)[2].expand(len(photos), 1)
        return torch.cat([place.to(photos), height], 1)

    @staticmethod
    def photograph(maps: Maps, light: Tensor, view: Tensor) -> Tensor:
        """Render display values [..., 3, H, W] of maps under a flash; light and view [..., 3]."""
        place = texel_positions(*maps.diffuse.shape[-2:], dtype=light.dtype, device=light.device)
        return radiance_to_display(render_maps(maps, place, light, view, falloff=FLASH_FALLOFF))

    def look(self, answer: Maps | Tensor, described: Batch) -> Tensor:
        light = described["light"][:, None]
        return self.photograph(answer, light, light) if isinstance(answer, Maps) else answer

    def evenly_lit(self, pictures: Tensor, described: Batch) -> Tensor:
        return remove_shading(pictures, described["light"])

    def targets(self, tasks: Tasks, windows: Tensor) -> Batch:
        """Return what fits of tasks are compared with in windows [T, N], [T, ...]."""
        rows = tasks.rows
        named = [key for key in tasks.data if key in ("light", "pooled", "chroma", "detail", "truth")]
        targets = {key: tasks.data[key][rows] for key in named}
        for i in range(self.octaves.count_maps(self.octaves.find_octave(tasks.data))):
            targets[f"spectrum{i}"] = tasks.data[f"spectrum{i}"][rows]
            targets[f"gram{i}"] = tasks.data[f"gram{i}"][rows[:, None], windows]
        return targets

    def distances(self, pictures: Tensor, batch: Batch, *, cropped: bool = False) -> dict[str, Tensor]:
        """Return how far pictures [T, S, 3, H, W] are from a batch, [T] each: Gram matrices, spectra, pooled pictures.

        Args:
            pictures: sRGB in [0, 1].
            batch: as `targets` returns it, with `windows`.
            cropped: whether the finest octave is compared in the first window alone, and by no spectra.
        """
        leading, flat, octave = pictures.shape[:2], pictures.flatten(0, 1), self.octaves.find_octave(batch)
        pooled = adaptive_avg_pool2d(flat, POOLED_PX).unflatten(0, leading)
        windows = batch["windows"].tolist()
        first = [own[0] for own in windows for _ in range(leading[1])]
        cropped = cropped and octave == 0 and self.octaves.count > 1
        crop = (lambda images: torch.stack(list(map(crop_window, images, first)))) if cropped else None
        found = self.compute_features(flat, octave, crop)
        whole = self.octaves.count_maps(1) if cropped else len(found)
        grams, spectra = [], []
        for i, maps in enumerate(found):
            wanted = batch[f"gram{i}"][:, None]
            if i < whole:
                spectra.append(
                    statistics_distance(
                        [amplitude_spectrum(maps).unflatten(0, leading)], [batch[f"spectrum{i}"][:, None]]
                    )
                )
                made = grams_of_tasks(maps.unflatten(0, leading), windows)
            else:
                made, wanted = gram(maps * fade_weights(maps)).unflatten(0, leading)[:, :, None], wanted[:, :, :1]
            grams.append(statistics_distance([made], [wanted]).mean((1, 2)))
        return {
            "gram": torch.stack(grams).mean(0),
            "spectrum": SPECTRUM_WEIGHT * torch.stack(spectra).mean((0, 2)),
            "pooled": (pooled - batch["pooled"][:, None]).abs().mean((1, 2, 3, 4)),
        }

    @torch.no_grad()
    def errors(self, answer: Maps | Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure maps [T, B, ...] of the exemplar's size, or of photographs [T, B, 3, H, W] of them, sRGB in [0, 1].

        `relit` is the error under other lights and from elsewhere, if the data set has references of that.
        Photographs are under the exemplar's light and have none.
        """
        every = torch.arange(WINDOWS_PER_SIDE * WINDOWS_PER_SIDE, device=tasks.rows.device).expand(len(tasks), -1)
        batch = {"windows": every} | self.targets(tasks, every)
        distances = self.distances(self.look(answer, batch), batch)
        errors = {
            "error": distances["gram"],
            "spectrum": distances["spectrum"] / SPECTRUM_WEIGHT,
            "brightness": distances["pooled"],
        }
        if "relit" in tasks.data and isinstance(answer, Maps):
            errors["relit"] = self._relit(answer, tasks.data["relit"][tasks.rows])
        return errors

    def _relit(self, maps: Maps, references: Tensor) -> Tensor:
        errors = []
        for i, (light, view) in enumerate(relighting_positions(device=references.device).values()):
            pictures = self.photograph(maps, light, view)
            target = self.octaves.take_exemplar(references[:, i].float() / 255)
            grams = [
                [
                    grams_in_windows(part, range(WINDOWS_PER_SIDE * WINDOWS_PER_SIDE))
                    for part in self.compute_features(images, 0)
                ]
                for images in (pictures.flatten(0, 1), target)
            ]
            made = [part.unflatten(0, pictures.shape[:2]) for part in grams[0]]
            errors.append(statistics_distance(made, [part[:, None] for part in grams[1]]).mean((1, 2)))
        return torch.stack(errors).mean(0)


def encode_gloss(specular: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """Return the network's output for specular and roughness of any shape, before any range was imposed."""
    ends = ((specular, 1e-9), ((roughness - 0.1) / 0.9, 1e-6))  # torch's logit has one eps for both ends
    # no float32 is 1 - 1e-9
    raw = [part.clamp_min(eps).log() - torch.log1p(-part.clamp_max(1 - 1e-6)) for part, eps in ends]
    return raw[0] + 3, raw[1]


def chroma_deviations(photos: Tensor) -> Tensor:
    """Return standard deviations [B, 2] of red less green and of yellow less blue, of photos [B, 3, H, W]."""
    red, green, blue = photos.unbind(1)
    opponents = torch.stack([red - green, (red + green) / 2 - blue], 1)
    return (opponents.var((2, 3)) + 1e-6).sqrt()


def _shine(photos: Tensor, light: Tensor) -> Tensor:
    """The highlight's confidence in the gloss, 0 to 1, and specular and roughness as networks make them, [B, 3]."""
    highlight = estimate_gloss(avg_pool2d(photos, 2), light)
    low, high = LOBE_SHARES
    sure = ((highlight.central_lobe_share - low) / (high - low)).clamp(0, 1) * (
        highlight.roughness < MAX_LOBE_ROUGHNESS
    )
    made = encode_gloss(highlight.specular.clamp(0.01, 0.5), highlight.roughness.clamp(0.12, 0.98))
    return torch.stack([sure, *made], 1)

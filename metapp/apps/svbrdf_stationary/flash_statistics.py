"""The statistics of flash photographs: features window by window, the light, and the gloss that the highlight shows.

A flash lights each place differently, so that statistics of a whole picture would mix bright and dark places. Maps are
known here as what is rendered; how a network makes them is in `app`, but for the ranges of gloss.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d
from typing_extensions import override

from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display
from metapp.appearance.features import amplitude_spectrum, gram, moments, statistics_distance
from metapp.appearance.flash import camera_position, relighting_positions, render_maps, texel_positions
from metapp.appearance.flash_search import estimate_flash_position
from metapp.appearance.highlight import estimate_gloss, remove_shading, ring_profile
from metapp.appearance.lattice import even_out_contrast
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.exemplar.exemplar_statistics import Statistics
from metapp.apps.svbrdf_stationary.windows import (
    WINDOW_COUNT,
    crop_window,
    fade_weights,
    grams_in_windows,
    grams_of_tasks,
    mask_ring,
)
from metapp.learning.task import Batch, Tasks

POOLED_PX = 8  # side of pooled pictures
SPECTRUM_WEIGHT = 0.3  # weight of spectra in the loss, beside 1 for Gram matrices
RING_BOUNDS = ((0.0, 0.2), (0.2, 0.8), (0.8, 3.0))  # squared distances from the centre, in half sides of the photo
# A highlight shows the gloss where it is much of the light reflected below the flash: confidence rises from 0 to 1
# between these shares. It shows no greater roughness.
LOBE_SHARES, MAX_LOBE_ROUGHNESS = (0.6, 0.8), 0.5
# Rings about the flash that are so many times as bright as the median px belong to the highlight; at most a share of px
HIGHLIGHT_RADIANCE_RATIO, MAX_UNUSABLE_SHARE = 2.0, 0.25
FLASH_FALLOFF = 1.0  # of the flash, as :func:`render_maps` takes it
SPECULAR_LOGIT = -3.0  # specular in logits where a network gives 0: about 0.05, as most dielectrics have
LEAST_ROUGHNESS = 0.1  # the roughness of maps is between this and 1


class FlashStatistics(Statistics):
    """Statistics of pictures under the flash of a photograph.

    The light depends on the place, so statistics are compared window by window: each window of a picture with the
    photo's window at that place.
    """

    statistic_names = ("gram", "spectrum")

    @override
    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Describe photos [B, 3, h, w] of the size of an octave.

        Returns:
            Of each feature map `gram0`, `gram1` and so on [B, N, C, C], Gram matrices in all N windows, and `spectrum0`
            and so on, amplitude spectra; `pooled` [B, 3, POOLED_PX, POOLED_PX]; `light` [B, 3], the position of the
            flash; `chroma` [B, 2], see :func:`chroma_deviations`; `shine` [B, 3], the confidence in the highlight,
            0 to 1, and the logits of specular and roughness that it shows; `summary` [B, S].
        """
        maps, light = self.compute_features(exemplars, octave), self.find_light(exemplars)
        described = {"light": light, "pooled": adaptive_avg_pool2d(exemplars, POOLED_PX)}
        described |= {"chroma": chroma_deviations(exemplars), "shine": _read_gloss(exemplars, light)}
        for index, features in enumerate(maps):
            described[f"gram{index}"] = grams_in_windows(features, range(WINDOW_COUNT))
            described[f"spectrum{index}"] = amplitude_spectrum(features)
        return described | {"summary": self.summarise(maps, octave)}

    @override
    def summarise(self, maps: list[Tensor], octave: int) -> Tensor:
        """Return means of features in three rings, and root mean squares, each divided by the root of the ring's share.

        The rings are those of strong, medium and weak light.
        """
        all_maps = self.octaves.repeat_finest(maps, octave)
        rings = [[mask_ring(features, low, high) for features in all_maps] for low, high in RING_BOUNDS]
        return torch.cat([moments(ring) for ring in rings], 1)

    @property
    @override
    def summary_size(self) -> int:
        return len(RING_BOUNDS) * super().summary_size

    def find_light(self, photos: Tensor) -> Tensor:
        """Estimate the positions [B, 3] of the flashes of photos [B, 3, h, w], in half sides of the patch."""
        offset = estimate_flash_position(photos)
        height = camera_position(dtype=photos.dtype, device=photos.device)[2].expand(len(photos), 1)
        return torch.cat([offset.to(photos), height], 1)

    @staticmethod
    def photograph(maps: Maps, light: Tensor, view: Tensor) -> Tensor:
        """Render maps under a flash, as a photograph.

        Args:
            maps: maps [..., C, H, W].
            light, view: positions of the flash and the camera, [..., 3], in half sides of the patch.

        Returns:
            Display values [..., 3, H, W].
        """
        place = texel_positions(*maps.diffuse.shape[-2:], dtype=light.dtype, device=light.device)
        return radiance_to_display(render_maps(maps, place, light, view, falloff=FLASH_FALLOFF))

    @override
    def render_prediction(self, prediction: Maps | Tensor, described: Batch) -> Tensor:
        light = described["light"][:, None]
        return self.photograph(prediction, light, light) if isinstance(prediction, Maps) else prediction

    @override
    def even_light(self, pictures: Tensor, described: Batch) -> Tensor:
        return even_out_contrast(remove_shading(pictures, described["light"]))

    @override
    def find_unusable(self, pictures: Tensor, described: Batch) -> Sequence[Tensor | None]:
        """Return the px of the highlight, where gloss hides the material: rings about the flash that are very bright.

        Of a matte surface none is, since its rings are at most about 1.5 times as bright as the median one.
        """
        means, memberships = ring_profile(pictures.clamp(0, 1) ** DISPLAY_GAMMA, described["light"])
        radiance = (means.mean(1, keepdim=True) @ memberships).unflatten(-1, pictures.shape[-2:])[:, 0]
        median = radiance.flatten(1).median(1).values
        brightest = radiance.flatten(1).quantile(1 - MAX_UNUSABLE_SHARE, 1)
        bound = torch.maximum(HIGHLIGHT_RADIANCE_RATIO * median, brightest)
        return list(radiance > bound[:, None, None])

    def targets(self, tasks: Tasks, windows: Tensor) -> Batch:
        """Return what pictures are compared with in windows of the numbers [T, N], by name, [T, ...] each."""
        rows = tasks.rows
        targets = tasks.gather(("light", "pooled", "chroma"))
        for index in range(self.octaves.count_maps(self.octaves.find_octave(tasks.data))):
            targets[f"spectrum{index}"] = tasks.data[f"spectrum{index}"][rows]
            targets[f"gram{index}"] = tasks.data[f"gram{index}"][rows[:, None], windows]
        return targets

    def distances(self, pictures: Tensor, batch: Batch, *, cropped: bool = False) -> dict[str, Tensor]:
        """Measure distances of pictures from photos.

        Args:
            pictures: S pictures of each task, [T, S, 3, H, W], sRGB in [0, 1].
            batch: what :meth:`targets` returns, and `windows` [T, N].
            cropped: whether the finest octave is compared in the first window alone, and without spectra.

        Returns:
            The distances of Gram matrices `gram`, spectra `spectrum`, and pooled pictures `pooled`, [T] each.
        """
        leading, images, octave = pictures.shape[:2], pictures.flatten(0, 1), self.octaves.find_octave(batch)
        pooled = adaptive_avg_pool2d(images, POOLED_PX).unflatten(0, leading)
        windows = batch["windows"].tolist()
        first = [task_windows[0] for task_windows in windows for _ in range(leading[1])]
        cropped = cropped and octave == 0 and self.octaves.count > 1
        crop = (lambda part_images: torch.stack(list(map(crop_window, part_images, first)))) if cropped else None
        feature_maps = self.compute_features(images, octave, crop)
        whole_count = self.octaves.count_maps(1) if cropped else len(feature_maps)
        grams, spectra = [], []
        for index, features in enumerate(feature_maps):
            target_grams = batch[f"gram{index}"][:, None]
            if index < whole_count:
                spectrum = amplitude_spectrum(features).unflatten(0, leading)
                spectra.append(statistics_distance([spectrum], [batch[f"spectrum{index}"][:, None]]))
                picture_grams = grams_of_tasks(features.unflatten(0, leading), windows)
            else:
                picture_grams = gram(features * fade_weights(features)).unflatten(0, leading)[:, :, None]
                target_grams = target_grams[:, :, :1]
            grams.append(statistics_distance([picture_grams], [target_grams]).mean((1, 2)))
        return {
            "gram": torch.stack(grams).mean(0),
            "spectrum": SPECTRUM_WEIGHT * torch.stack(spectra).mean((0, 2)),
            "pooled": (pooled - batch["pooled"][:, None]).abs().mean((1, 2, 3, 4)),
        }

    @override
    @torch.no_grad()
    def errors(self, prediction: Maps | Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure maps [T, B, ...] of the exemplar's size, or photographs of them [T, B, 3, H, W], sRGB in [0, 1].

        Returns:
            `error`, by Gram matrices; `spectrum`; `brightness`, by pooled pictures; and of maps whose tasks have
            references under other lights and from elsewhere, `relit`, by Gram matrices under these; [T] each.
        """
        windows = torch.arange(WINDOW_COUNT, device=tasks.rows.device).expand(len(tasks), -1)
        batch = {"windows": windows} | self.targets(tasks, windows)
        distances = self.distances(self.render_prediction(prediction, batch), batch)
        errors = {
            "error": distances["gram"],
            "spectrum": distances["spectrum"] / SPECTRUM_WEIGHT,
            "brightness": distances["pooled"],
        }
        if "relit" in tasks.data and isinstance(prediction, Maps):
            errors["relit"] = self._relit_error(prediction, tasks.data["relit"][tasks.rows])
        return errors

    def _relit_error(self, maps: Maps, references: Tensor) -> Tensor:
        """Return the mean distance [T] of Gram matrices of maps under other lights from references [T, 3, 3, S, S]."""
        errors = []
        for index, (light, view) in enumerate(relighting_positions(device=references.device).values()):
            pictures = self.photograph(maps, light, view)
            target = self.octaves.take_exemplar(references[:, index].float() / 255)
            grams = [
                [grams_in_windows(features, range(WINDOW_COUNT)) for features in self.compute_features(images, 0)]
                for images in (pictures.flatten(0, 1), target)
            ]
            picture_grams = [features.unflatten(0, pictures.shape[:2]) for features in grams[0]]
            errors.append(statistics_distance(picture_grams, [features[:, None] for features in grams[1]]).mean((1, 2)))
        return torch.stack(errors).mean(0)


def encode_gloss(specular: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
    """Return the logits that the network makes specular and roughness of, for values of any shape."""
    shares = (
        (specular, 1e-9),
        ((roughness - LEAST_ROUGHNESS) / (1 - LEAST_ROUGHNESS), 1e-6),
    )  # torch.logit has one eps for both ends
    # float32 has no 1 - 1e-9
    logits = [share.clamp_min(eps).log() - torch.log1p(-share.clamp_max(1 - 1e-6)) for share, eps in shares]
    return logits[0] - SPECULAR_LOGIT, logits[1]


def chroma_deviations(photos: Tensor) -> Tensor:
    """Return standard deviations [B, 2] of red minus green and of yellow minus blue in photos [B, 3, H, W]."""
    red, green, blue = photos.unbind(1)
    opponents = torch.stack([red - green, (red + green) / 2 - blue], 1)
    return (opponents.var((2, 3)) + 1e-6).sqrt()


def _read_gloss(photos: Tensor, light: Tensor) -> Tensor:
    """Read gloss off highlights of photos [B, 3, h, w]: `shine` [B, 3], see :meth:`FlashStatistics.describe`."""
    highlight = estimate_gloss(avg_pool2d(photos, 2), light)
    low, high = LOBE_SHARES
    confidence = ((highlight.central_lobe_share - low) / (high - low)).clamp(0, 1) * (
        highlight.roughness < MAX_LOBE_ROUGHNESS
    )
    logits = encode_gloss(highlight.specular.clamp(0.01, 0.5), highlight.roughness.clamp(0.12, 0.98))
    return torch.stack([confidence, *logits], 1)

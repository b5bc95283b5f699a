"""The statistics of flash photographs: features window by window, the light, and the gloss that the highlight shows.

A flash lights each place differently, so that statistics of a whole picture would mix bright and dark places. One
photograph does not tell diffuse colour, specular colour and relief apart: priors keep them near what is usual.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate
from typing_extensions import override

from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display
from metapp.appearance.features import (
    amplitude_spectrum,
    detail_difference,
    detail_statistics,
    gram,
    moments,
    statistics_distance,
)
from metapp.appearance.flash import camera_position, relighting_positions, render_maps, texel_positions
from metapp.appearance.flash_search import estimate_flash_position
from metapp.appearance.highlight import estimate_gloss, remove_shading, ring_profile
from metapp.appearance.lattice import even_out_contrast, remove_quadratic_trend
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.exemplar.exemplar_codec import move_tiles
from metapp.apps.exemplar.exemplar_statistics import Statistics, gather_known
from metapp.apps.svbrdf_stationary.material_codec import MaterialAnswer, encode_gloss
from metapp.apps.svbrdf_stationary.true_maps import compare_map_statistics, compare_texels, gloss_deviation, turn_maps
from metapp.apps.svbrdf_stationary.windows import (
    WINDOW_COUNT,
    crop_window,
    fade_weights,
    grams_in_windows,
    grams_of_tasks,
    mask_ring,
)
from metapp.learning.task import Batch, Task, Tasks
from metapp.networks.quilted import fetch_pieces, quilt_deviation

POOLED_PX = 8  # side of pooled pictures
SPECTRUM_WEIGHT = 0.3  # weight of spectra in the loss, beside 1 for Gram matrices
RING_BOUNDS = ((0.0, 0.2), (0.2, 0.8), (0.8, 3.0))  # squared distances from the centre, in half sides of the photo
# A highlight shows the gloss where it is much of the light reflected below the flash: confidence rises from 0 to 1
# between these shares. It shows no greater roughness.
LOBE_SHARES, MAX_LOBE_ROUGHNESS = (0.6, 0.8), 0.5
# Rings about the flash that are so many times as bright as the median px belong to the highlight; at most a share of px
HIGHLIGHT_RADIANCE_RATIO, MAX_UNUSABLE_SHARE = 2.0, 0.25
FLASH_FALLOFF = 1.0  # of the flash, as :func:`render_maps` takes it
DRAWN_WINDOWS = 3  # windows of the photo that one step compares
GLOSS_PRIOR_WEIGHT = 0.5  # weight in the loss of the distance of gloss from the expected one, if one is expected
TRUTH_NAMES = ("truth", "maps")  # tensors of tasks that outer losses compare
POOLED_WEIGHT = 3.0  # of pooled pictures in the outer loss, 1 in that of fits: they hold the shape of the highlight
MAP_WEIGHT = 3.0  # weight in the outer loss of the differences from the true maps
LINE_WINDOW_PX = 9  # side of windows, odd, in which a photograph is compared with the photograph in even light
LINE_DEVIATION = 0.005  # standard deviation of display values below which a window counts as flat
COLOUR_WEIGHT = 3.0  # weight in the loss of the difference of standard deviations of chroma from the photo's
SOFTNESS_WEIGHT = 0.2  # weight in the loss of the difference of the finest detail from the exemplar's


class FlashStatistics(Statistics):
    """Statistics of pictures under the flash of a photograph.

    The light depends on the place, so statistics are compared window by window: each window of a picture with the
    photo's window at that place.

    Tasks may hold what no fit sees: `relit`, uint8 [3, 3, S, S], photographs under three other lights, for errors; and
    for outer losses, `truth` [3, 2, 6], the statistics of the true maps at three resolutions, and with quilts, `maps`
    [10, M, M], the true maps over the photograph at its exposure, packed by
    :func:`metapp.appearance.svbrdf_maps.pack_maps`.
    """

    statistic_names = ("gram", "spectrum")

    @override
    @torch.no_grad()
    def describe(self, exemplars: Tensor, octave: int = 0) -> dict[str, Tensor]:
        """Describe photos [B, 3, h, w] of the size of an octave.

        Returns:
            Of each feature map `gram0`, `gram1` and so on [B, N, C, C], Gram matrices in all N windows, and `spectrum0`
            and so on, amplitude spectra; `pooled` [B, 3, POOLED_PX, POOLED_PX]; `light` [B, 3], the position of the
            flash; `chroma` [B, 2], see :func:`chroma_deviations`; `detail` [B, 3, N], how fine detail is, see
            :func:`detail_statistics`; `shine` [B, 3], the confidence in the highlight, 0 to 1, and the logits of
            specular and roughness that it shows; `summary` [B, S].
        """
        maps, light = self.compute_features(exemplars, octave), self.find_light(exemplars)
        described = {"light": light, "pooled": adaptive_avg_pool2d(exemplars, POOLED_PX)}
        described |= {"chroma": chroma_deviations(exemplars), "detail": detail_statistics(exemplars)}
        described["shine"] = _read_gloss(exemplars, light)
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

    @override
    def take_even_photo(self, image: Tensor) -> Tensor:
        """Return a photograph without its shading, by lines that are fitted window by window at the exemplar's size."""
        photo = image.float() / 255
        exemplar = self.octaves.take_exemplar(photo[None])
        unshaded = self.even_light(exemplar, {"light": self.find_light(exemplar)})
        even = remove_quadratic_trend(unshaded[0])[None]
        factor, offset = (
            interpolate(values, size=photo.shape[-2:], mode="bilinear", align_corners=False)[0]
            for values in fit_local_lines(exemplar, even)
        )
        return (factor * photo + offset).clamp(0, 1)

    @override
    def targets(self, tasks: Tasks, rng: Generator | None = None) -> Batch:
        """Return the numbers of `windows` [T, N], random ones or all, and the photos' statistics in these."""
        rows, order = tasks.rows, torch.arange(WINDOW_COUNT, device=tasks.rows.device)
        if rng is not None:
            order = torch.randperm(WINDOW_COUNT, generator=rng, device=rng.device)[:DRAWN_WINDOWS]
        windows = order.expand(len(tasks), -1)
        targets = {"windows": windows} | tasks.gather(("light", "pooled", "chroma", "detail"))
        for index in range(self.octaves.count_maps(self.octaves.find_octave(tasks.data))):
            targets[f"spectrum{index}"] = tasks.data[f"spectrum{index}"][rows]
            targets[f"gram{index}"] = tasks.data[f"gram{index}"][rows[:, None], windows]
        return targets

    @override
    def loss(self, answer: MaterialAnswer, described: Batch) -> Tensor:
        """Return the distance of pictures from the photo, [T], and of gloss from the expected one."""
        loss = torch.stack(list(self.compare(answer, described).values())).sum(0)
        if answer.expected_gloss is None:
            return loss
        return loss + GLOSS_PRIOR_WEIGHT * gloss_deviation(answer.prediction, answer.expected_gloss.detach())

    def compare(self, answer: MaterialAnswer, described: Batch) -> dict[str, Tensor]:
        """Return the distances of materials from photos under whose light they are rendered, by name, [T] each.

        Gram matrices in windows, spectra of features and pooled pictures are compared; and of quilts, the deviations
        of colours, the pictures in even light with the quilts, and how soft their detail is.
        """
        pictures = self.render_prediction(answer.prediction, described)
        distances = self.distances(pictures, described, cropped=True)
        if answer.quilts is None:
            return distances
        chroma = chroma_deviations(pictures.flatten(0, 1)).unflatten(0, pictures.shape[:2])
        distances["colour"] = COLOUR_WEIGHT * (chroma - described["chroma"][:, None]).abs().mean((1, 2))
        evenly_lit = remove_shading(pictures, described["light"][:, None])
        distances["deviation"] = quilt_deviation(evenly_lit, answer.quilts)
        distances["softness"] = self.measure_softness(pictures, described)
        return distances

    def measure_softness(self, pictures: Tensor, described: Batch) -> Tensor:
        """Return the part of a loss, [T], that keeps the detail of pictures [T, B, 3, H, W] as fine as the exemplars'.

        It is 0 for pictures of coarser octaves.
        """
        if self.octaves.find_octave(described):
            return pictures.new_zeros(len(pictures))
        return SOFTNESS_WEIGHT * detail_difference(detail_statistics(pictures), described["detail"][:, None]).mean(1)

    def distances(self, pictures: Tensor, batch: Batch, *, cropped: bool = False) -> dict[str, Tensor]:
        """Measure distances of pictures from photos.

        Args:
            pictures: S pictures of each task, [T, S, 3, H, W], sRGB in [0, 1].
            batch: what :meth:`targets` returns.
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
    def prepare(self, task: Task, decoder: Any) -> Batch:
        known = {name: task.data[name] for name in ("relit", "truth") if name in task.data}
        has_maps = decoder.reads_quilts and "maps" in task.data
        return known | ({"maps": task.data["maps"].float()} if has_maps else {})

    @override
    def gather(self, tasks: Tasks) -> Batch:
        """Return the photographs under other lights."""
        return gather_known(tasks, "relit")

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Return `truth` [T, 3, 2, 6], and the true maps at the places of the quilts, `maps` [T, 10, H, W], if any."""
        known = gather_known(tasks, *TRUTH_NAMES)
        if "maps" in known:
            cells = self.octaves.octave_size()
            pairs = zip(known["maps"], tasks.data["places"][tasks.rows], strict=True)
            known["maps"] = torch.stack([fetch_pieces(maps, places, cells, cells) for maps, places in pairs])
        return known

    @override
    def vary_truth(self, tasks: Tasks, is_flipped: Tensor, is_transposed: Tensor, channels: Tensor) -> Batch:
        known = gather_known(tasks, *TRUTH_NAMES)
        if "truth" in known:
            order = torch.cat([channels, torch.arange(3, 6, device=channels.device).expand(len(channels), -1)], 1)
            known["truth"] = known["truth"].gather(-1, order[:, None, None].expand(known["truth"].shape))
        if "maps" in known:
            changes = zip(known["maps"], is_flipped, is_transposed, channels, strict=True)
            known["maps"] = torch.stack([turn_maps(*change) for change in changes])
        return known

    @override
    @torch.no_grad()
    def errors(self, prediction: Maps | Tensor, seen: Batch, truth: Batch) -> dict[str, Tensor]:
        """Measure maps [T, B, ...] of the exemplar's size, or photographs of them [T, B, 3, H, W], sRGB in [0, 1].

        Returns:
            `error`, by Gram matrices; `spectrum`; `brightness`, by pooled pictures; and of maps whose tasks have
            references under other lights and from elsewhere, `relit`, by Gram matrices under these; [T] each.
        """
        distances = self.distances(self.render_prediction(prediction, seen), seen)
        errors = {
            "error": distances["gram"],
            "spectrum": distances["spectrum"] / SPECTRUM_WEIGHT,
            "brightness": distances["pooled"],
        }
        if "relit" in truth and isinstance(prediction, Maps):
            errors["relit"] = self._relit_error(prediction, truth["relit"])
        return errors

    @override
    def outer_loss(self, answer: MaterialAnswer, seen: Batch, truth: Batch) -> Tensor:
        """Return the distance of pictures from the photo plus the difference of maps from the true ones, [T]."""
        distances = self.compare(answer, seen)
        distances["pooled"] = POOLED_WEIGHT * distances["pooled"]
        map_loss = compare_map_statistics(answer.prediction, truth.get("truth"))
        if "maps" in truth:
            texels = unpack_maps(move_tiles(truth["maps"], seen["noise"]))
            map_loss = map_loss + MAP_WEIGHT * compare_texels(answer.prediction, texels)
        return torch.stack(list(distances.values())).sum(0) + map_loss

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

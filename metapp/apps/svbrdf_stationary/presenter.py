"""The presenter of stationary svBRDFs: maps that tile, photographs of them, and warnings.

Warnings about lost structure come from :mod:`metapp.apps.exemplar.presenter`; here are pictures of maps, and warnings
about highlights that clip in the photo, and about relief.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Surface
from metapp.appearance.colour import srgb_to_linear, stretch_to_unit_range
from metapp.appearance.doubts import BROKEN_LINES_OF_MATERIAL, BROKEN_ROWS, GUESSED_RELIEF
from metapp.appearance.flash import relighting_positions
from metapp.appearance.highlight import F0_BOUND_CLAUSE, clipped_highlight_warnings
from metapp.appearance.lattice import remove_quadratic_trend
from metapp.appearance.pictures import PictureComparison
from metapp.appearance.svbrdf_maps import Maps, mean_tilt_degrees
from metapp.apps.exemplar.breaks import break_strength
from metapp.apps.exemplar.presenter import ExemplarPresenter
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF
from metapp.learning.task import Params, Task, Tasks

UNMOVED_NOISE = -9.0  # of the numbers that say how far tiles are moved: not at all


class SvbrdfStationaryPresenter(ExemplarPresenter):
    """The presenter of maps that tile: beside their flash photograph, and under other lights."""

    picture_measure = "a photograph of the maps under the exemplar's light and, with references, under three others"
    broken_lines = BROKEN_LINES_OF_MATERIAL

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return the photo and the fit under its light, then the maps, and pictures of them under other lights."""
        octaves, statistics = self.app.decoder.octaves, self.app.sight.statistics
        photo = octaves.take_exemplar(task.data["image"][None].float() / 255)
        light = statistics.find_light(photo)
        maps, height = self._generate_material(theta)
        fit = statistics.photograph(maps, light[0], light[0])
        displayed = {"reference": photo[0].permute(1, 2, 0), "fit": fit.permute(1, 2, 0)}
        surface = self.options.adapt_asset(Surface(maps, True, height, FLASH_FALLOFF))
        displayed |= {name: picture.pixels for name, picture in surface.pictures().items()}
        displayed["height"] = stretch_to_unit_range(displayed["height"])[0]
        return {name: srgb_to_linear(picture).expand(-1, -1, 3) for name, picture in displayed.items()}

    @override
    @torch.no_grad()
    def comparison(self, theta: Params, task: Task) -> PictureComparison:
        """Return the maps under the photo's light and, where the task has references, under other lights."""
        octaves, statistics = self.app.decoder.octaves, self.app.sight.statistics
        photos = [task.data["image"][None], *([task.data["relit"]] if "relit" in task.data else [])]
        references = torch.cat([octaves.take_exemplar(images.float() / 255) for images in photos])
        light, maps = statistics.find_light(references[:1])[0], self._generate_material(theta)[0]
        pairs = [(light, light), *relighting_positions(device=light.device).values()][: len(references)]
        return PictureComparison(torch.stack([statistics.photograph(maps, *pair) for pair in pairs]), references)

    @override
    @torch.no_grad()
    def remarks(self, theta: Params, task: Task) -> Mapping[str, object]:
        """Add the mean tilt of fitted normals, `mean_tilt_degrees`, without the factor `relief`."""
        tilt = mean_tilt_degrees(self._generate_material(theta)[0].normal)
        return {"mean_tilt_degrees": tilt, **super().remarks(theta, task)}

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Add clauses on clipped highlights and on relief; there are clauses only where networks read quilts.

        That relief breaks at cuts is said where nothing else is found lost.
        """
        warnings = super().quality_warnings(theta, tasks)
        if "places" not in theta:
            return warnings
        images, noise = tasks.data["image"][tasks.rows].float() / 255, self.app.decoder.shown_noise(tasks.rows)
        material, photo_normals = self.app.decoder.generate(theta, noise), self._generate_photo_normals(theta, tasks)
        return [
            (clauses or _doubt_rows(photo_normal, places))
            + clipped_highlight_warnings(image, F0_BOUND_CLAUSE)
            + GUESSED_RELIEF.about(mean_tilt_degrees(normal))
            for clauses, image, photo_normal, normal, places in zip(
                warnings, images, photo_normals, material.prediction.normal, theta["places"], strict=True
            )
        ]

    def _generate_photo_normals(self, theta: Params, tasks: Tasks) -> Tensor:
        """Generate the normals that fits would have if their quilts were the photos in even light, [T, 3, H, W]."""
        data = {key: value[tasks.rows] for key, value in tasks.data.items()}
        decoder, statistics = self.app.decoder, self.app.sight.statistics
        unshaded = statistics.even_light(decoder.octaves.take_exemplar(data["image"].float() / 255), data)
        even = torch.stack([remove_quadratic_trend(photo) for photo in unshaded])
        noise = torch.full_like(decoder.shown_noise(tasks.rows), UNMOVED_NOISE)
        normals: Tensor = decoder.generate(theta | {"quilt": even}, noise).prediction.normal[:, 0]
        return normals

    def _generate_material(self, theta: Params) -> tuple[Maps, Tensor]:
        """Generate maps [C, H, W] of one material at the exemplar's size, and their height [1, H, W] in texels."""
        material = self.generate_shown(theta)
        return Maps(*(part[0, 0] for part in material.prediction)), material.height[0, 0]


def _doubt_rows(photo_normal: Tensor, places: Tensor) -> list[str]:
    """Return a clause on rows of the relief that break at cuts between pieces, or none.

    Args:
        photo_normal: the normals of the photo, [3, H, W]; nearly flat ones show no break.
        places: the place in the photo of each of the fit's cells, [2, H, W].
    """
    if mean_tilt_degrees(photo_normal) < GUESSED_RELIEF.limit:
        return []
    return BROKEN_ROWS.about(break_strength(photo_normal[:2], places))

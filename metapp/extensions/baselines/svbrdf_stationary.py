"""Baselines of stationary svBRDFs from a flash photograph: the nearest training material, and quilted maps.

The nearest material predicts its photograph, the other method maps. Both are judged by the application's own
measure of pictures.
"""

from __future__ import annotations

from typing import cast

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.assets import Photograph, Surface
from metapp.appearance.colour import DISPLAY_GAMMA, srgb_to_linear
from metapp.appearance.height_fields import height_from_normal, normal_from_height
from metapp.appearance.highlight import estimate_gloss, remove_shading
from metapp.appearance.lattice import subtract_local_mean
from metapp.appearance.stretch import stretch_to_tile
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.exemplar.exemplar_sight import JUDGED_PICTURES
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.extensions.baselines.texture import NearestExemplar, leave_out_quilts, quilt_pictures
from metapp.learning.app import App
from metapp.learning.task import Task, Tasks

# Relief is guessed of brightness: RELIEF_WINDOW_TEXELS is the side of a texel's surroundings, RELIEF_DEPTH_TEXELS the
# height of a texel that is twice as bright as these, both in texels of a photo of 256. Where a clear highlight takes
# CLEAR_HIGHLIGHT_SHARE of the light right below the flash, the surface is smooth, and brightness shows colour. Of
# depths of 0, 0.5, 1, 1.5 texels and shares of 0.5 to 1.1 these have the least mean error of relit pictures, on 22
# materials of the training split.
RELIEF_WINDOW_TEXELS, RELIEF_DEPTH_TEXELS, CLEAR_HIGHLIGHT_SHARE = 33, 1.0, 0.8
QUILTED_MATERIAL_NUMBERS = 5  # stored beside the photo: diffuse red, green and blue, F0, roughness


def quilt_maps(
    photo: Tensor,
    light: Tensor,
    rng: Generator,
    size: tuple[int, int] | None = None,
    count: int = JUDGED_PICTURES,
) -> Maps:
    """Quilt maps of the material of a flash photo, which tile, from pieces of the photo.

    The photo without its shading is quilted. Its mean becomes the diffuse albedo that the highlight's profile gives; F0
    varies with brightness about the F0 that the profile gives, and roughness is constant. Texels that are darker than
    their surroundings lie deeper, except on metals and below clear highlights.

    Args:
        photo: the photograph, [1, 3, H, W], display values in [0, 1].
        light: the position of its flash, [1, 3].
        rng: chooses among pieces that fit about as well.
        size: the height and width of the maps in texels; None for the photo's.
        count: the number of materials.

    Returns:
        The maps, [1, count, C, *size].
    """
    highlight, unshaded = estimate_gloss(photo, light), remove_shading(photo, light)[0].clamp(0, 1)
    side, size = unshaded.shape[1], size or (unshaded.shape[1], unshaded.shape[2])
    pictures = quilt_pictures(stretch_to_tile(unshaded, size)[0], size, rng, tiles=True, count=count)
    colours, mean = pictures**DISPLAY_GAMMA, (unshaded**DISPLAY_GAMMA).mean((1, 2)).clamp_min(1e-4)
    brightness = colours.mean(-3, keepdim=True) / mean.mean()
    ones, grey = torch.ones_like(brightness), pictures.mean(-3, keepdim=True)
    relief = subtract_local_mean(grey, RELIEF_WINDOW_TEXELS * side // 256 | 1) / grey.mean((-1, -2), keepdim=True)
    smooth = highlight.lobe_share[0].where(highlight.central_lobe_share[0] < CLEAR_HIGHLIGHT_SHARE, torch.ones(()))
    relief_texels = RELIEF_DEPTH_TEXELS * (1 - smooth) * side / 256
    return Maps(
        (colours * (highlight.diffuse[0] / mean)[:, None, None]).clamp(0, 1),
        (brightness * highlight.specular[0]).clamp(0, 1),
        ones * highlight.roughness[0],
        normal_from_height(relief_texels * relief),
    )


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of flash photographs of stationary materials, which read no quilts of fits."""
    app = leave_out_quilts(app)
    return NearestPhoto(app), QuiltedMaterial(app)


class NearestPhoto(NearestExemplar):
    """The training photograph with the least error, as it is."""

    title = "the training photograph with the least error"
    cannot = "be a material that is not in its set, nor be lit from elsewhere: it is a photograph"


class QuiltedMaterial(Baseline):
    """Maps quilted from pieces of the photo; a fit is timed for as many materials as are judged.

    A fit stores the photograph and QUILTED_MATERIAL_NUMBERS.
    """

    name = "quilting"
    title = "the photo without its light, quilted (Efros & Freeman 2001), and the gloss of its highlight's profile"
    cannot = (
        "make anything but pieces of the photo, which it repeats, nor tell what a highlight hides or how gloss varies: "
        "roughness is constant, F0 goes with brightness, colours below the highlight are a guess"
    )
    is_resizable = True

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        statistics = cast(SvbrdfStationary, self.app).judge
        photos = statistics.octaves.take_exemplar(tasks.data["image"][tasks.rows].float() / 255)
        light = tasks.data["light"][tasks.rows]
        maps = quilt_maps(photos, light, rng)
        photo_numbers = photos.numel()
        picture = statistics.photograph(Maps(*(values[0, 0] for values in maps)), light[0], light[0])

        def make_surface(task: Task, size: tuple[int, int] | None) -> Surface:
            shown = Maps(
                *(values[0, 0] for values in (quilt_maps(photos, light, rng, size, count=1) if size else maps))
            )
            height = height_from_normal(shown.normal, periodic=True)
            return Surface(shown, True, height, FLASH_FALLOFF, {"photo_1": Photograph(light[0], light[0])})

        return BaselineFit(
            lambda: maps,
            photo_numbers + QUILTED_MATERIAL_NUMBERS,
            photo_numbers + 4 * QUILTED_MATERIAL_NUMBERS,
            make_surface,
            srgb_to_linear(picture).permute(1, 2, 0),
        )

"""Baselines of networks of stationary svBRDFs: the nearest training material, and maps quilted of the photo itself."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.appearance.flash import DISPLAY_GAMMA, Maps, normal_from_height
from metapp.appearance.highlight import estimate_gloss, remove_shading
from metapp.appearance.order import subtract_local_mean
from metapp.apps.exemplar.app import JUDGED_PICTURES
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.extensions.baselines.baseline import Baseline, BaselineFit, CostLimits
from metapp.extensions.baselines.texture import NearestExemplar, quilt_pictures, srgb_to_linear_picture
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.networks.layout import stretch_to_tile

# Of relief: the side of a texel's surroundings and, where a texel is twice as bright as these, its height, both in
# texels of photos of 256. Below a clear highlight a surface is smooth, and what its brightness shows is colour: of 0,
# 0.5, 1, 1.5 texels, and shares of the lobe right below the flash of 0.5 to 1.1, these have the least mean error of
# relit pictures, on 22 materials of the training split.
RELIEF_WINDOW_TEXELS, RELIEF_DEPTH_TEXELS, CLEAR_HIGHLIGHT_SHARE = 33, 1.0, 0.8
QUILTED_MATERIAL_NUMBERS = 5  # beside the photo: diffuse red, green and blue, F0, roughness


def quilt_maps(
    photo: Tensor,
    light: Tensor,
    rng: Generator,
    size: tuple[int, int] | None = None,
    count: int = JUDGED_PICTURES,
) -> Maps:
    """Quilt maps [1, count, ...] of the material of a flash photo, which tile: pieces of it.

    The photo without its light is quilted. Its mean becomes the diffuse albedo that the highlight's profile says; F0
    varies as brightness does about the profile, roughness not at all. Texels that are darker than their surroundings
    lies deeper, but on metals and below clear highlights.

    Args:
        photo: one, [1, 3, H, W], display values in [0, 1].
        light: position of its flash, [1, 3].
        rng: chooses among pieces that fit about as well.
        size: height and width of the maps in texels; None for the photo's.
        count: the number of materials.
    """
    highlight, even = estimate_gloss(photo, light), remove_shading(photo, light)[0].clamp(0, 1)
    side, size = even.shape[1], size or (even.shape[1], even.shape[2])
    pictures = quilt_pictures(stretch_to_tile(even, size)[0], size, rng, tiles=True, count=count)
    colours, mean = pictures**DISPLAY_GAMMA, (even**DISPLAY_GAMMA).mean((1, 2)).clamp_min(1e-4)
    brightness = colours.mean(-3, keepdim=True) / mean.mean()
    one, gray = torch.ones_like(brightness), pictures.mean(-3, keepdim=True)
    relief = subtract_local_mean(gray, RELIEF_WINDOW_TEXELS * side // 256 | 1) / gray.mean((-1, -2), keepdim=True)
    smooth = highlight.share[0].where(highlight.contrast[0] < CLEAR_HIGHLIGHT_SHARE, torch.ones(()))
    texels = RELIEF_DEPTH_TEXELS * (1 - smooth) * side / 256
    return Maps(
        (colours * (highlight.diffuse[0] / mean)[:, None, None]).clamp(0, 1),
        (brightness * highlight.specular[0]).clamp(0, 1),
        one * highlight.roughness[0],
        normal_from_height(texels * relief),
    )


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of flash photographs of stationary materials."""
    return NearestPhoto(app), QuiltedMaterial(app)


class NearestPhoto(NearestExemplar):
    """The training photograph with the least error."""

    title = "the training photograph with the least error"
    cannot = "be a material that is not in its set, nor be lit from elsewhere: it is a photograph"


class QuiltedMaterial(Baseline):
    """Maps of pieces of the photo; seconds are of as many materials as are judged."""

    name = "quilting"
    title = "the photo without its light, quilted (Efros & Freeman 2001), and the gloss of its highlight's profile"
    cannot = (
        "make anything but pieces of the photo, which it repeats, nor tell what a highlight hides or how gloss varies: "
        "roughness is constant, F0 goes with brightness, colours below the highlight are a guess"
    )
    sizes = True

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The photograph and NUMBERS are kept."""
        app = self.app
        assert isinstance(app, SvbrdfStationary)
        photos = app.octaves.take_exemplar(tasks.data["image"][tasks.rows].float() / 255)
        light = tasks.data["light"][tasks.rows]
        maps = quilt_maps(photos, light, rng)
        kept = photos.numel()
        picture = srgb_to_linear_picture(
            app.statistics.photograph(Maps(*(part[0, 0] for part in maps)), light[0], light[0])
        )

        def written(asked: tuple[int, int] | None) -> Maps:
            return quilt_maps(photos, light, rng, asked, count=1) if asked else maps

        return BaselineFit(
            lambda: maps,
            kept + QUILTED_MATERIAL_NUMBERS,
            kept + 4 * QUILTED_MATERIAL_NUMBERS,
            picture=picture,
            written=written,
        )

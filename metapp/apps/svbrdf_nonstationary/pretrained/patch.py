"""The description of a whole photographed patch, which stays with each window of it.

Features look at pixels, and a highlight is as large as the patch: so gloss is read off a small picture of all of the
patch, and off the maps that General by the recipe "full" makes, which was trained on ten times as many materials.
"""

from __future__ import annotations

import functools
from typing import cast

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.apps.svbrdf_nonstationary.pretrained.highlight_roughness import describe_highlight
from metapp.apps.svbrdf_nonstationary.recipes import PHOTO_RECIPES
from metapp.learning.task import Params
from metapp.storage.checkpoint_files import read_entry
from metapp.storage.shipped_checkpoints import FULL_RECIPE_NAME, shipped_checkpoint_path

SIDE_STEP_PX = 8  # sides of photographs are multiples of it, as the fourth level of features is 8 times as coarse
OVERVIEW_PX = 32  # side of the overview, in which highlights have one size whatever a photograph's resolution
GUESS_CHANNELS = 3  # roughness, and the logs of specular and diffuse reflectance, by General of the recipe "full"
LOG_FLOOR = 0.01  # reflectance that is added before logs
FULL_APP = cast("SvbrdfNonstationary", PHOTO_RECIPES[FULL_RECIPE_NAME].app)
FULL_DECODER = cast("FieldMaps", FULL_APP.decoder)
PATCH_KEYS = ("overview", "highlight", "guess", "code", "flash")  # what `describe_patch` returns


@torch.no_grad()
def describe_patch(photos: Tensor) -> Params:
    """Describe linear photographs [T, 3, H, W] of a whole patch, so that windows of it can be read with this context.

    Returns:
        `overview` [T, 3, OVERVIEW_PX, OVERVIEW_PX], the reduced photographs; `highlight` [T, HIGHLIGHT_NUMBERS]; and
        what General of the recipe "full" predicts, at its side S: `guess` [T, GUESS_CHANNELS, S, S], and the parameters
        of its maps, `code` [T, C, S, S] and `flash` [T, FLASH_NUMBERS].
    """
    small = interpolate(photos, FULL_DECODER.size, mode="bilinear")
    theta = FULL_APP.encode(load_full_general(photos.device), {"photo": small})
    maps = FULL_DECODER.make_maps(theta, small)
    log_reflectances = [
        (reflectance.mean(1, keepdim=True) + LOG_FLOOR).log() for reflectance in (maps.specular, maps.diffuse)
    ]
    overview = interpolate(avg_pool2d(photos, SIDE_STEP_PX), (OVERVIEW_PX, OVERVIEW_PX), mode="bilinear")
    guess = torch.cat([maps.roughness, *log_reflectances], 1)
    description = {"overview": overview, "highlight": describe_highlight(photos), "guess": guess}
    return description | {"code": theta["z"], "flash": theta["flash"]}


@functools.cache
def load_full_general(device: torch.device) -> Params:
    """Load General of the recipe "full" that ships."""
    return read_entry(shipped_checkpoint_path(FULL_APP.name, FULL_RECIPE_NAME), "general-photo", device)[0].encoder

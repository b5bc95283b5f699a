"""General's encoder of a flash photograph: a small decoder over frozen features of VGG-16.

Features that know real pictures tell relief from colour where an encoder that has seen drawn materials alone does not.
Features have the size of pixels, highlights that of the patch: gloss is read off a small picture of all of it, and off
the maps that General by the recipe "full" makes, which was trained on ten times as many materials. The trained part is
the decoder; VGG's weights are those that `metapp data vgg` keeps, in no checkpoint.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import cast

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, grid_sample, interpolate, leaky_relu, pad

from metapp.appearance.features import in_bfloat16, load_features, weights_path
from metapp.appearance.flash import positions
from metapp.apps.svbrdf_nonstationary.coded_maps import FromPhoto
from metapp.apps.svbrdf_nonstationary.encoder import BASE, SLOPE, block, pointwise, twice
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_VALUE
from metapp.apps.svbrdf_nonstationary.pretrained.polish import add_polish, highlight_of, shown_roughness
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.learning.task import Params
from metapp.networks.layers import add_layer
from metapp.storage.checkpoints import load_checkpoint
from metapp.storage.shipped import FULL, shipped_path

TAPS = {"relu1_2": 64, "relu2_2": 128, "relu3_3": 256, "relu4_3": 512}  # and their channels; each half as fine
WIDTHS = (32, 64, 96, 128)  # channels of the levels, the finest first
STEP_PX = 1 << (len(TAPS) - 1)  # sides of photographs are a multiple of it
TONE, GAMMA = 0.35, 2.2  # of the mean of a photograph, as VGG sees it
PIXEL_INPUTS = 12  # channels of what is known of each pixel beside the features
LEAST_TINT = 0.2  # of the mean colour, over its brightness: what is darker is not brightened as much
LEAST = 1e-3  # brightness
PARTS = ("diffuse", "specular", "roughness", "normal")  # maps with a predicted error, in the order of `differences`
DEVIATION, LEAST_SCALE = 0.1, 0.01  # of all maps at first, and at least
UNKNOWN_LOG = 10.0  # of a predicted error that says nothing
DEVIATION_LEVEL = 2  # a quarter of the photograph's side
OVERVIEW = 32  # side in px of the overview: highlights have the same size in it whatever a photograph's resolution
COARSER = 4  # how many times as coarse its second level is
OVERVIEWS = (32, 48)  # channels of its levels
GUESS, DARK = 3, 0.01  # channels of what General by "full" makes of a photograph; what is added before logs
FULL_APP = cast("FromPhoto", RECIPES["photo"][FULL].app)


def init_decoder(rng: Generator, code: int) -> Params:
    """Random parameters, whose output is `code` numbers in a pixel."""
    decoder: Params = {}
    layer = functools.partial(add_layer, decoder, rng)
    for level, (width, channels) in enumerate(zip(WIDTHS, TAPS.values(), strict=True)):
        coarser = WIDTHS[level + 1 : level + 2]
        layer(f"level{level}.features", width, channels)
        for below in coarser:
            layer(f"level{level}.coarser", width, below)
        layer(f"level{level}.first", width, width * (1 + len(coarser)) + PIXEL_INPUTS, 3, 3)
        layer(f"level{level}.second", width, width, 3, 3, gain=0.7)
        layer(f"level{level}.mean", width, width, gain=0.5)
        layer(f"level{level}.overview", width, sum(OVERVIEWS), gain=0.0)
        layer(f"level{level}.guess", width, GUESS, gain=0.0)
    for level, (width, below) in enumerate(zip(OVERVIEWS, (PIXEL_INPUTS, *OVERVIEWS), strict=False)):
        layer(f"overview{level}.first", width, below, 3, 3)
        layer(f"overview{level}.second", width, width, 3, 3, gain=0.7)
        layer(f"overview{level}.mean", width, width, gain=0.5)
    add_polish(decoder, rng)
    layer("code", code, WIDTHS[0], gain=0.3)
    layer("deviation", len(PARTS), WIDTHS[DEVIATION_LEVEL], gain=0.0)
    decoder["deviation.shift"] += math.log(DEVIATION)
    return decoder


def read_photos(decoder: Params, photos: Tensor, place: Tensor | None = None, patch: Params | None = None) -> Params:
    """Codes of linear photographs [T, 3, H, H], H a multiple of STEP_PX.

    Args:
        decoder: as of `init_decoder`.
        photos: of any exposure and white balance.
        place: where the pixels are, [T, 2, H, H]; None if they show all of the patch.
        patch: as `patch_of` makes it of all of the patch; None if the photographs show that.

    Returns:
        `z`, the code [T, code, H, H] and after it that of General by "full", `flash` [T, FLASH] by that,
        `deviation` [T, len(PARTS), H / 4, H / 4], logs, and `shown` [T], the roughness by the highlight.

    Raises:
        ValueError: no weights of VGG-16; another side.
    """
    if photos.shape[-1] % STEP_PX or photos.shape[-2] % STEP_PX:
        raise ValueError(f"photos of {photos.shape[-1]} px, expected a multiple of {STEP_PX}; set another size.")
    if place is None:
        place = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[None]
    patch = patch_of(photos) if patch is None else patch
    mean = patch["overview"].mean((2, 3), keepdim=True)
    balanced, known = _balanced(photos, place, mean)
    whole = positions(OVERVIEW, OVERVIEW, dtype=photos.dtype, device=photos.device)[None]
    _, small = _balanced(patch["overview"], whole, mean)
    with torch.autocast(photos.device.type, torch.bfloat16, enabled=in_bfloat16(photos.device)):
        fine = block(decoder, "overview0", small)
        coarse = block(decoder, "overview1", avg_pool2d(fine, COARSER))
        surroundings = torch.cat([fine, interpolate(coarse, scale_factor=COARSER, mode="bilinear")], 1)
        x, result = None, {}
        for level, features in reversed(list(enumerate(_features(balanced)))):
            here = pointwise(decoder, f"level{level}.features", features)
            around = pointwise(decoder, f"level{level}.overview", surroundings)
            at = avg_pool2d(place, 1 << level)
            guessed = pointwise(decoder, f"level{level}.guess", _at(patch["guess"], at))  # finer than levels: first
            here = leaky_relu(here + _at(around, at).to(here) + guessed, SLOPE)
            parts = [here, avg_pool2d(known, 1 << level).to(here)]
            parts += [] if x is None else [twice(pointwise(decoder, f"level{level}.coarser", x))]
            # channels first: half the time where gradients are wanted, while VGG likes them last
            x = block(decoder, f"level{level}", torch.cat([part.contiguous() for part in parts], 1))
            if level == DEVIATION_LEVEL:
                result["deviation"] = pointwise(decoder, "deviation", x).float()
        assert x is not None
        code = pointwise(decoder, "code", x).float()
    result |= {"z": torch.cat([code, _at(patch["code"], place)], 1), "flash": patch["flash"]}
    return result | {"shown": shown_roughness(decoder, patch["highlight"])}


@torch.no_grad()
def patch_of(photos: Tensor) -> Params:
    """The knowledge of linear photographs [T, 3, H, W] of all of a patch, whatever window of it is looked at.

    Returns:
        `overview` [T, 3, OVERVIEW, OVERVIEW]; `highlight`, as of `highlight_of`; by General of "full", S its side:
        `guess` [T, GUESS, S, S], roughness and the logs of mean specular and diffuse reflectance, `code`
        [T, its code, S, S], `flash` [T, FLASH], as numbers of any size.
    """
    network = FULL_APP.network
    small = interpolate(photos, (network.height, network.width), mode="bilinear")
    theta = FULL_APP.encode(full_encoder(photos.device), {"photo": small})
    maps = FULL_APP.maps_of(theta, small)
    shades = [(reflectance.mean(1, keepdim=True) + DARK).log() for reflectance in (maps.specular, maps.diffuse)]
    overview = interpolate(avg_pool2d(photos, STEP_PX), (OVERVIEW, OVERVIEW), mode="bilinear")
    own = {"code": network.gain * theta["z"], "flash": network.gain * theta["flash"]}
    guess = torch.cat([maps.roughness, *shades], 1)
    return own | {"overview": overview, "highlight": highlight_of(photos), "guess": guess}


@functools.cache
def full_encoder(device: torch.device) -> Params:
    """The encoder of General by "full" that ships."""
    return load_checkpoint(shipped_path(FULL_APP.name, "general-photo", FULL), device)[0].encoder


def lacks() -> str:
    """A line about a file that better maps need and that is missing; "" for none."""
    if weights_path().is_file():
        return ""
    return "the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them"


def _at(around: Tensor, place: Tensor) -> Tensor:
    """The surroundings of pixels at places [T, 2, h, w] of a patch."""
    grid = torch.stack([place[:, 0], -place[:, 1]], 3).expand(len(around), -1, -1, -1)
    return grid_sample(around.float(), grid, padding_mode="border", align_corners=False)


def _balanced(photos: Tensor, place: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
    """Photographs over a mean colour [T, 3, 1, 1], and inputs of their pixels, [T, PIXEL_INPUTS, H, W].

    The logs of the balanced colours, how brightness differs among neighbours, the place, clipping; and, the same all
    over, how bright and of what tint the mean is: colour and exposure then say nothing of relief by themselves.
    """
    grey = mean.mean(1, keepdim=True).clamp_min(LEAST)
    white = torch.maximum(mean, LEAST_TINT * grey)
    balanced = photos / white
    logs = (balanced + 0.05).log()
    wide = pad(logs.mean(1, keepdim=True), (1, 1, 1, 1), mode="replicate")
    across, up = wide[..., 1:-1, 2:] - wide[..., 1:-1, :-2], wide[..., :-2, 1:-1] - wide[..., 2:, 1:-1]
    clips = (photos > CLIPPED_VALUE).any(1, keepdim=True).to(photos)
    overall = torch.cat([grey.log() / 3, (white / grey).log()], 1).expand(-1, -1, *photos.shape[-2:])
    known = [logs, across, up, place.expand(len(photos), -1, -1, -1), clips, overall]
    return balanced, torch.cat(known, 1)


def _features(balanced: Tensor) -> list[Tensor]:
    """The features of balanced photographs [T, 3, H, W], the finest first; in bfloat16 on CPUs that are made for it.

    Raises:
        ValueError: no weights of VGG-16.
    """
    if lacks():
        raise ValueError(
            f"{weights_path()}: no such file, expected the weights of VGG-16, which the recipe pretrained reads; get "
            "them by metapp data vgg, or fit by --recipe full."
        )
    with torch.no_grad():
        images = (TONE * balanced).clamp(0, 1) ** (1 / GAMMA)
        # without a graph that says no more than: in reduced precision
        features: list[Tensor] = load_features(tuple(TAPS), images)(images.requires_grad_(), reduced=True)
    return features


def unknown_deviation(count: int, device: torch.device) -> Params:
    """`deviation` [count, 4, BASE, BASE] of fits whose maps' errors nothing is known of; no step moves it."""
    return {"deviation": torch.full((count, len(PARTS), BASE, BASE), UNKNOWN_LOG, device=device)}


def laplace_scales(theta: Params) -> Tensor:
    """Laplace's scale of the error of each map, mean over its channels, as large as `deviation`."""
    return LEAST_SCALE + theta["deviation"].exp()


def negative_log_likelihood(apart: Sequence[Tensor], theta: Params) -> Tensor:
    """Negative log-likelihood of errors of maps, as of `differences`, but for a constant, [T] (Kendall & Gal 2017).

    Only `deviation` has a gradient of it.
    """
    scale = laplace_scales(theta)
    size = (scale.shape[-2], scale.shape[-1])
    off = [adaptive_avg_pool2d(part.detach(), size).abs().mean(1, keepdim=True) for part in apart]
    return (torch.cat(off, 1) / scale + scale.log()).mean((1, 2, 3))

"""General's encoder of a flash photograph: a small decoder over frozen features of VGG-16.

Features that know real pictures tell relief from colour where an encoder that has seen drawn materials alone does not.
What is trained is the decoder; VGG's weights are those that `metapp data vgg` keeps, in no checkpoint.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import NamedTuple, cast

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, leaky_relu, pad

from metapp.appearance.features import load_features, weights_path
from metapp.appearance.flash import positions
from metapp.appearance.precision import in_bfloat16
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import PARTS, SLOPE, block, pointwise, twice
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_VALUE, RAW
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.learning.task import Params
from metapp.networks.layers import add_layer
from metapp.runs.recipes import FULL, shipped_path
from metapp.storage.checkpoints import load_checkpoint

TAPS = {"relu1_2": 64, "relu2_2": 128, "relu3_3": 256, "relu4_3": 512}  # and their channels; each half as fine
WIDTHS = (32, 64, 96, 128)  # channels of the levels, the finest first
LARGEST = 1 << (len(TAPS) - 1)  # what the sides of photographs must be multiples of
TONE, GAMMA = 0.35, 2.2  # of the mean of a photograph, as VGG sees it
KNOWN = 12  # channels of what is known of each pixel beside the features
LEAST_TINT = 0.2  # of the mean colour, over its brightness: what is darker is not brightened as much
LEAST = 1e-3  # brightness
DEVIATION = 0.1  # of all maps at first
AT = 2  # the level that deviations are read at, a quarter of the photograph's side
OVERVIEW = 32  # side in px of the overview: highlights have the same size in it whatever a photograph's resolution
COARSER = 4  # how many times as coarse its second level is
OVERVIEWS = (32, 48)  # channels of its levels
GUESS, DARK = 3, 0.01  # channels of what the smaller network makes of a photograph; what is added before logs
SMALLER = cast("SvbrdfNonstationary", RECIPES["photo"][FULL].app)
SHARE = 0.5  # the smaller network's share of diffuse colour, roughness and specular colour; it has none of slopes
DECODER = "decoder."


class FeatureEncoder(NamedTuple):
    """A decoder over features of VGG-16, whose levels all know the photograph, an overview, and a guess.

    Features have the size of pixels, highlights that of the patch: gloss is read off a small picture of all of it, and
    off the maps that General by the recipe "full" makes, which was trained on ten times as many materials.

    Attributes:
        code: length of the code in a pixel.
    """

    code: int

    def init(self, rng: Generator) -> Params:
        """Random parameters.

        Raises:
            ValueError: no weights of VGG-16.
        """
        require_weights()
        encoder: Params = {}
        for level, (width, channels) in enumerate(zip(WIDTHS, TAPS.values(), strict=True)):
            coarser = WIDTHS[level + 1 : level + 2]
            add_layer(encoder, rng, f"level{level}.features", width, channels)
            for below in coarser:
                add_layer(encoder, rng, f"level{level}.coarser", width, below)
            add_layer(encoder, rng, f"level{level}.first", width, width * (1 + len(coarser)) + KNOWN, 3, 3)
            add_layer(encoder, rng, f"level{level}.second", width, width, 3, 3, gain=0.7)
            add_layer(encoder, rng, f"level{level}.mean", width, width, gain=0.5)
            add_layer(encoder, rng, f"level{level}.overview", width, sum(OVERVIEWS), gain=0.0)
            add_layer(encoder, rng, f"level{level}.guess", width, GUESS, gain=0.0)
        for level, (width, below) in enumerate(zip(OVERVIEWS, (KNOWN, *OVERVIEWS), strict=False)):
            add_layer(encoder, rng, f"overview{level}.first", width, below, 3, 3)
            add_layer(encoder, rng, f"overview{level}.second", width, width, 3, 3, gain=0.7)
            add_layer(encoder, rng, f"overview{level}.mean", width, width, gain=0.5)
        add_layer(encoder, rng, "code", self.code, WIDTHS[0], gain=0.3)
        add_layer(encoder, rng, "deviation", len(PARTS), WIDTHS[AT], gain=0.0)
        encoder["deviation.shift"] += math.log(DEVIATION)
        return encoder

    def __call__(
        self, encoder: Params, photos: Tensor, place: Tensor | None = None, patch: Params | None = None
    ) -> Params:
        """Read linear photographs [T, 3, H, H], H a multiple of LARGEST.

        Args:
            encoder: the decoder's parameters.
            photos: of any exposure and white balance.
            place: where the pixels are, [T, 2, H, H]; None where they show all of the patch.
            patch: as `patch_of` makes it of all of the patch; None where the photographs show that.

        Returns:
            `z`, the code [T, code, H, H] and after it that of the smaller network, `flash` [T, FLASH] by that, and
            `deviation` [T, len(PARTS), H / 4, H / 4], logs.

        Raises:
            ValueError: no weights of VGG-16; another side.
        """
        if photos.shape[-1] % LARGEST or photos.shape[-2] % LARGEST:
            raise ValueError(f"photos of {photos.shape[-1]} px, expected a multiple of {LARGEST}; set another size.")
        if place is None:
            place = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[None]
        patch = patch_of(photos) if patch is None else patch
        mean = patch["overview"].mean((2, 3), keepdim=True)
        balanced, known = _balanced(photos, place, mean)
        whole = positions(OVERVIEW, OVERVIEW, dtype=photos.dtype, device=photos.device)[None]
        _, small = _balanced(patch["overview"], whole, mean)
        with torch.autocast(photos.device.type, torch.bfloat16, enabled=in_bfloat16(photos.device)):
            surroundings = _surroundings(encoder, small)
            x, result = None, {}
            for level, features in reversed(list(enumerate(_features(balanced)))):
                here = pointwise(encoder, f"level{level}.features", features)
                around = pointwise(encoder, f"level{level}.overview", surroundings)
                at = avg_pool2d(place, 1 << level)
                guessed = pointwise(encoder, f"level{level}.guess", _at(patch["guess"], at))  # finer than levels: first
                here = leaky_relu(here + _at(around, at).to(here) + guessed, SLOPE)
                parts = [here, avg_pool2d(known, 1 << level).to(here)]
                parts += [] if x is None else [twice(pointwise(encoder, f"level{level}.coarser", x))]
                # channels first: half the time where gradients are wanted, while VGG likes them last
                x = block(encoder, f"level{level}", torch.cat([part.contiguous() for part in parts], 1))
                if level == AT:
                    result["deviation"] = pointwise(encoder, "deviation", x)
            assert x is not None
            result["z"] = pointwise(encoder, "code", x)
        read = {key: value.float() for key, value in result.items()}
        return read | {"z": torch.cat([read["z"], _at(patch["code"], place)], 1), "flash": patch["flash"]}


def overview_of(photos: Tensor) -> Tensor:
    """Linear photographs [T, 3, H, W] of all of a patch at OVERVIEW px, [T, 3, OVERVIEW, OVERVIEW]."""
    return interpolate(avg_pool2d(photos, LARGEST), (OVERVIEW, OVERVIEW), mode="bilinear")


@torch.no_grad()
def patch_of(photos: Tensor) -> Params:
    """What is read of linear photographs [T, 3, H, W] of all of a patch, whatever window of it is looked at.

    Returns:
        `overview`, as of `overview_of`; of what General by "full" makes of them, S its side: `guess` [T, GUESS, S, S],
        roughness and the logs of mean specular and diffuse reflectance, `code` [T, SMALLER.network.code, S, S], `flash`
        [T, FLASH], as numbers of any size.
    """
    app, encoder = _smaller(photos.device)
    small = interpolate(photos, (app.network.height, app.network.width), mode="bilinear")
    theta = app.encode(encoder, {"photo": small})
    maps = app.maps_of(theta, small)
    shades = [(each.mean(1, keepdim=True) + DARK).log() for each in (maps.specular, maps.diffuse)]
    own = {"code": app.network.gain * theta["z"], "flash": app.network.gain * theta["flash"]}
    return own | {"overview": overview_of(photos), "guess": torch.cat([maps.roughness, *shades], 1)}


def beside_smaller(encoder: Params) -> Params:
    """The same parameters with the field's decoder and the smaller network's side by side, as one twice as wide.

    It makes the mean of what both make of their own codes, by SHARE: networks of other features and other training
    materials err differently. Of slopes it makes what the first makes.
    """
    own = {key: value for key, value in encoder.items() if key.startswith(DECODER)}
    device = own[f"{DECODER}out.shift"].device
    share = torch.tensor([0.0] * RAW[0] + [SHARE] * sum(RAW[1:]), device=device)
    _, other = _smaller(device)
    joined = {}
    for key, value in own.items():
        if key == f"{DECODER}out.shift":
            joined[key] = torch.lerp(value, other[key], share)
        elif key.startswith(f"{DECODER}out."):
            joined[key] = torch.cat([(1 - share[:, None]) * value, share[:, None] * other[key]], 1)
        elif key.endswith(".shift") or key == f"{DECODER}layer0.kernel":
            joined[key] = torch.cat([value, other[key]])
        else:
            joined[key] = torch.block_diag(value, other[key])
    return encoder | joined


def halves_of(theta: Params, code: int, hidden: int) -> tuple[Params, Params]:
    """The two fields [T, ...] that `beside_smaller` has made one of; what they make adds up to what it makes.

    Args:
        theta: parameters of the field.
        code, hidden: how long the first one's code is, how many hidden units it has.
    """

    def half(units: slice, cells: slice) -> Params:
        part = {"z": theta["z"][:, cells]}
        for name, value in theta.items():
            layer, _, kind = name.partition(".")
            if kind:
                part[name] = value if layer == "out" else value[:, units]
                if kind != "shift" and name != "layer0.kernel":
                    part[name] = part[name][..., cells if kind == "code" else units]
        return part

    second = half(slice(hidden, None), slice(code, None))
    return half(slice(hidden), slice(code)), second | {"out.shift": torch.zeros_like(theta["out.shift"])}


@functools.cache
def _smaller(device: torch.device) -> tuple[SvbrdfNonstationary, Params]:
    """The application of the recipe "full", and the encoder of its General that ships."""
    app = replace(SMALLER, protocol="photo")
    general, _ = load_checkpoint(shipped_path(app.name, "general-photo", FULL), device)
    return app, general.encoder


def lacks() -> str:
    """What better maps need and this machine has not, in a line; "" for nothing."""
    if weights_path().is_file():
        return ""
    return "the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them"


def require_weights() -> None:
    """Refuse to go on without the weights of VGG-16.

    Raises:
        ValueError: they are not there.
    """
    if lacks():
        raise ValueError(
            f"{weights_path()}: no such file, expected the weights of VGG-16, which the recipe pretrained reads; get "
            "them by metapp data vgg, or fit by --recipe full."
        )


def _surroundings(encoder: Params, known: Tensor) -> Tensor:
    """What levels know of the overview, [T, sum(OVERVIEWS), OVERVIEW, OVERVIEW], of what is known of its pixels."""
    fine = block(encoder, "overview0", known)
    coarse = block(encoder, "overview1", avg_pool2d(fine, COARSER))
    return torch.cat([fine, interpolate(coarse, scale_factor=COARSER, mode="bilinear")], 1)


def _at(around: Tensor, place: Tensor) -> Tensor:
    """What is around pixels at such places [T, 2, h, w] of a patch."""
    grid = torch.stack([place[:, 0], -place[:, 1]], 3).expand(len(around), -1, -1, -1)
    return grid_sample(around.float(), grid, padding_mode="border", align_corners=False)


def _balanced(photos: Tensor, place: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
    """Photographs over a mean colour [T, 3, 1, 1], and what is known of their pixels, [T, KNOWN, H, W].

    The logs of the balanced colours, how brightness differs among neighbours, the place, what clips; and, the same all
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
    """The features of balanced photographs [T, 3, H, W], the finest first; in bfloat16 on CPUs that are made for it."""
    require_weights()
    with torch.no_grad():
        images = (TONE * balanced).clamp(0, 1) ** (1 / GAMMA)
        # without a graph that says no more than: in reduced precision
        features: list[Tensor] = load_features(tuple(TAPS), images)(images.requires_grad_(), reduced=True)
    return features

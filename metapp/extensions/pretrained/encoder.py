"""General's encoder of a flash photograph: a small decoder over frozen features of VGG-16.

Features that know real pictures tell relief from colour where an encoder that has seen drawn materials alone does not.
What is trained is the decoder; VGG's weights are those that `metapp data vgg` keeps, in no checkpoint.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, leaky_relu, pad

from metapp.appearance.features import load_features, weights_path
from metapp.appearance.flash import positions
from metapp.appearance.precision import in_bfloat16
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import SLOPE, block, pointwise, twice
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED
from metapp.apps.svbrdf_nonstationary.recipes import RECIPES
from metapp.learning.task import Params
from metapp.networks.layers import add_layer, dense
from metapp.runs.checkpoints.shipped import FULL, shipped_path
from metapp.storage.records import load_checkpoint

TAPS = {"relu1_2": 64, "relu2_2": 128, "relu3_3": 256, "relu4_3": 512}  # and their channels; each half as fine
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


class FeatureEncoder(NamedTuple):
    """A decoder over features of VGG-16, whose levels all know the photograph, an overview, and a guess.

    Features have the size of pixels, highlights that of the patch: gloss is read off a small picture of all of it, and
    off the maps that General by the recipe "full" makes, which was trained on ten times as many materials.

    Attributes:
        code: length of the code in a pixel.
        flash: numbers that describe the flash.
        deviations: how many maps it says the deviation of.
        widths: channels of the levels, the finest first.
    """

    code: int
    flash: int
    deviations: int
    widths: tuple[int, ...] = (32, 64, 96, 128)

    def init(self, rng: Generator) -> Params:
        """Random parameters.

        Raises:
            ValueError: no weights of VGG-16.
        """
        require_weights()
        encoder: Params = {}
        for level, (width, channels) in enumerate(zip(self.widths, TAPS.values(), strict=True)):
            coarser = self.widths[level + 1 : level + 2]
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
        add_layer(encoder, rng, "code", self.code, self.widths[0], gain=0.3)
        add_layer(encoder, rng, "flash", self.flash, 2 * self.widths[-1], gain=0.1)
        if self.deviations:
            add_layer(encoder, rng, "deviation", self.deviations, self.widths[AT], gain=0.0)
            encoder["deviation.shift"] += math.log(DEVIATION)
        return encoder

    def __call__(
        self,
        encoder: Params,
        photos: Tensor,
        place: Tensor | None = None,
        overview: Tensor | None = None,
        guess: Tensor | None = None,
    ) -> Params:
        """Read linear photographs [T, 3, H, H], H a multiple of LARGEST.

        Args:
            encoder: the decoder's parameters.
            photos: of any exposure and white balance.
            place: where the pixels are, [T, 2, H, H]; None where they show all of the patch.
            overview, guess: as `overview_of` and `guess_of` make them of all of the patch; None where the photographs
                show that.

        Returns:
            `z`, the code [T, code, H, H], `flash` [T, flash], and, if it says any, `deviation`
            [T, deviations, H / 4, H / 4], logs.

        Raises:
            ValueError: no weights of VGG-16; another side.
        """
        if photos.shape[-1] % LARGEST or photos.shape[-2] % LARGEST:
            raise ValueError(f"photos of {photos.shape[-1]} px, expected a multiple of {LARGEST}; set another size.")
        if place is None:
            place = positions(*photos.shape[-2:], dtype=photos.dtype, device=photos.device)[None]
        overview = overview_of(photos) if overview is None else overview
        guess, flash = _by_smaller(photos) if guess is None else (guess, None)
        mean = overview.mean((2, 3), keepdim=True)
        balanced, known = _balanced(photos, place, mean)
        whole = positions(OVERVIEW, OVERVIEW, dtype=photos.dtype, device=photos.device)[None]
        _, small = _balanced(overview, whole, mean)
        with torch.autocast(photos.device.type, torch.bfloat16, enabled=in_bfloat16(photos.device)):
            surroundings = _surroundings(encoder, small)
            x, result = None, {}
            for level, features in reversed(list(enumerate(_features(balanced)))):
                here = pointwise(encoder, f"level{level}.features", features)
                around = pointwise(encoder, f"level{level}.overview", surroundings)
                at = avg_pool2d(place, 1 << level)
                guessed = pointwise(encoder, f"level{level}.guess", _at(guess, at))  # finer than levels: first
                here = leaky_relu(here + _at(around, at).to(here) + guessed, SLOPE)
                parts = [here, avg_pool2d(known, 1 << level).to(here)]
                parts += [] if x is None else [twice(pointwise(encoder, f"level{level}.coarser", x))]
                # channels first: half the time where gradients are wanted, while VGG likes them last
                x = block(encoder, f"level{level}", torch.cat([part.contiguous() for part in parts], 1))
                if level == len(TAPS) - 1:
                    ends = torch.cat([x.mean((2, 3)), x.amax((2, 3))], 1)
                    result["flash"] = dense(encoder, "flash", ends) if flash is None else flash
                if level == AT and self.deviations:
                    result["deviation"] = pointwise(encoder, "deviation", x)
            assert x is not None
            result["z"] = pointwise(encoder, "code", x)
        return {key: value.float() for key, value in result.items()}


def overview_of(photos: Tensor) -> Tensor:
    """Linear photographs [T, 3, H, W] of all of a patch at OVERVIEW px, [T, 3, OVERVIEW, OVERVIEW]."""
    return interpolate(avg_pool2d(photos, LARGEST), (OVERVIEW, OVERVIEW), mode="bilinear")


def guess_of(photos: Tensor) -> Tensor:
    """What General by "full" makes of linear photographs [T, 3, H, W] of all of a patch, [T, GUESS, S, S], S its side.

    Roughness, and the logs of mean specular and diffuse reflectance.
    """
    return _by_smaller(photos)[0]


@torch.no_grad()
def _by_smaller(photos: Tensor) -> tuple[Tensor, Tensor]:
    """What `guess_of` gives, and the flash [T, FLASH] as that General sees it: most windows, in training, show none."""
    app, encoder = _smaller(photos.device)
    photos = interpolate(photos, (app.field.height, app.field.width), mode="bilinear")
    theta = app.encode(encoder, {"photo": photos})
    maps = app.maps_of(theta, photos)
    shades = [(each.mean(1, keepdim=True) + DARK).log() for each in (maps.specular, maps.diffuse)]
    return torch.cat([maps.roughness, *shades], 1), app.field.gain * theta["flash"]


@functools.cache
def _smaller(device: torch.device) -> tuple[SvbrdfNonstationary, Params]:
    """The application of the recipe "full", and the encoder of its General that ships."""
    app = SvbrdfNonstationary(RECIPES["photo"][FULL].setup, "photo")
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
    if not weights_path().is_file():
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
    clips = (photos > CLIPPED).any(1, keepdim=True).to(photos)
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

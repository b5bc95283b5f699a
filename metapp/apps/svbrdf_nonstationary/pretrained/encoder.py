"""General's encoder of a flash photograph: a small reader of frozen features of VGG-16.

Features that know real pictures tell relief from colour where an encoder that has seen drawn materials alone does not.
Beside features it reads the description of the whole patch. The trained part is the reader; VGG's weights are those
that `metapp data vgg` keeps, in no checkpoint.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, grid_sample, interpolate, leaky_relu, pad
from typing_extensions import override

from metapp.appearance.features import feature_conditions, load_features, uses_bfloat16, vgg_weights_path
from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.encoder import ENCODER_LEAKY_SLOPE, apply_block, apply_pointwise, upsample
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, CLIPPED_LINEAR_VALUE, ROUGHNESS_CHANNEL, decode_maps
from metapp.apps.svbrdf_nonstationary.pretrained.ensemble_maps import (
    PARTS,
    SECOND_SHARE,
    join_fields,
    mark_second,
    scale_slopes,
    select_second,
)
from metapp.apps.svbrdf_nonstationary.pretrained.highlight_roughness import (
    add_highlight_reader,
    predict_roughness,
    roughness_shift,
)
from metapp.apps.svbrdf_nonstationary.pretrained.patch import (
    GUESS_CHANNELS,
    OVERVIEW_PX,
    PATCH_KEYS,
    SIDE_STEP_PX,
    load_full_general,
)
from metapp.learning.components import Encoder
from metapp.learning.learn import expand_tasks
from metapp.learning.task import Batch, Params
from metapp.networks.coded import add_decoder, join_encoder, select_decoder, select_reader
from metapp.networks.field import LocalField
from metapp.networks.layers import add_layer

# Layers of VGG-16, each half as fine as the one before, and their numbers of channels
TAPS = {"relu1_2": 64, "relu2_2": 128, "relu3_3": 256, "relu4_3": 512}
WIDTHS = (32, 64, 96, 128)  # channels of the reader's levels, the finest first
VGG_MEAN, GAMMA = 0.35, 2.2  # linear mean, and gamma, of the photographs that VGG sees
READER_PIXEL_INPUTS = 12  # numbers of a pixel that it reads beside features
MIN_TINT = 0.2  # a channel's mean over the mean of all channels; darker channels are brightened less
MIN_BRIGHTNESS = 1e-3  # linear mean, 1 is white, of photographs that are nearly black
INITIAL_DEVIATION = 0.1  # predicted errors of maps before training
DEVIATION_LEVEL = 2  # the level of the reader that predicts errors, at a quarter of the photograph's side
OVERVIEW_POOLING = 4  # the side of the overview's first level over the side of its second level
OVERVIEW_WIDTHS = (32, 48)  # channels of the levels of the overview


@dataclass(frozen=True)
class FeatureEncoder(Encoder[Any]):
    """The encoder of photographs, or in training of windows of photographs, by features of VGG-16."""

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return feature_conditions(device)

    @override
    def init(self, rng: Generator, decoder: Any) -> Params:
        """Draw the reader and the first field, whose maps are nearly flat: training begins without relief."""
        first_field: LocalField = decoder.network
        return join_encoder(init_reader(rng, first_field.code), scale_slopes(first_field.init(rng, 1)), ("z",))

    @override
    def select_input(self, seen: Any) -> Batch:
        """Select the photograph, describe its patch, and add the weights of the second field.

        Returns:
            `photo`, `inputs` and `camera_height`; `slopes_are_final` [T, 1, 1, 1], 1 for photographs of fits and 0 for
            those of training; what :func:`describe_patch` returns; and the second field's weights, as
            :func:`mark_second` names them.
        """
        photo, count = seen.photo, len(seen.photo)
        is_final = photo.new_full((count, 1, 1, 1), float(seen.slopes_are_final))
        selected = {"photo": photo, "inputs": seen.inputs, "camera_height": seen.camera_height}
        weights = mark_second(expand_tasks(select_decoder(load_full_general(photo.device)), count, 0))
        patch: Params = seen.describe_patch()
        return selected | {"slopes_are_final": is_final} | patch | weights

    @override
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        """Return the parameters of both fields, with a code in each pixel: read by features, and of General of "full".

        The roughness of both is then shifted to the roughness that a sharp highlight shows.
        """
        inputs, patch = encoder_input["inputs"], {key: encoder_input[key] for key in PATCH_KEYS}
        read = read_photos(select_reader(encoder), encoder_input["photo"], inputs[:, -2:], patch)
        first = add_decoder({"z": read["z"] / decoder.network.gain}, encoder)
        second = select_second(encoder_input) | {"z": _sample_at(patch["code"], inputs[:, -2:])}
        theta = join_fields(first, second) | {"flash": patch["flash"], "deviation": read["deviation"]}
        raw = decoder.evaluate(theta, inputs)
        maps, finished = decode_maps(raw), decoder.finish_maps(raw)
        # training sees slopes as the network makes them
        is_final = encoder_input["slopes_are_final"] > 0
        maps = maps._replace(normal=torch.where(is_final, finished.normal, maps.normal))
        return match_highlight(theta, maps, read["shown"], encoder_input["camera_height"])


def init_reader(rng: Generator, code: int) -> Params:
    """Draw random parameters of a reader whose output is `code` numbers in a pixel."""
    reader: Params = {}
    add_random_layer = functools.partial(add_layer, reader, rng)
    for level, (width, channels) in enumerate(zip(WIDTHS, TAPS.values(), strict=True)):
        coarser_widths = WIDTHS[level + 1 : level + 2]
        add_random_layer(f"level{level}.features", width, channels)
        for below in coarser_widths:
            add_random_layer(f"level{level}.coarser", width, below)
        add_random_layer(f"level{level}.first", width, width * (1 + len(coarser_widths)) + READER_PIXEL_INPUTS, 3, 3)
        add_random_layer(f"level{level}.second", width, width, 3, 3, gain=0.7)
        add_random_layer(f"level{level}.mean", width, width, gain=0.5)
        add_random_layer(f"level{level}.overview", width, sum(OVERVIEW_WIDTHS), gain=0.0)
        add_random_layer(f"level{level}.guess", width, GUESS_CHANNELS, gain=0.0)
    for level, (width, below) in enumerate(zip(OVERVIEW_WIDTHS, (READER_PIXEL_INPUTS, *OVERVIEW_WIDTHS), strict=False)):
        add_random_layer(f"overview{level}.first", width, below, 3, 3)
        add_random_layer(f"overview{level}.second", width, width, 3, 3, gain=0.7)
        add_random_layer(f"overview{level}.mean", width, width, gain=0.5)
    add_highlight_reader(reader, rng)
    add_random_layer("code", code, WIDTHS[0], gain=0.3)
    add_random_layer("deviation", len(PARTS), WIDTHS[DEVIATION_LEVEL], gain=0.0)
    reader["deviation.shift"] += math.log(INITIAL_DEVIATION)
    return reader


def read_photos(reader: Params, photos: Tensor, positions: Tensor, patch: Params) -> Params:
    """Predict from linear photographs the code of a field, the roughness of sharp highlights, and errors of maps.

    Args:
        reader: the parameters that `init_reader` draws.
        photos: linear photographs of any exposure and white balance, [T, 3, H, H].
        positions: the positions of the pixels in the patch, [T or 1, 2, H, H].
        patch: the tensors of :func:`describe_patch` for the whole patch, of which the photographs may show a window.

    Returns:
        `z`, the code [T, code, H, H]; `deviation` [T, len(PARTS), H / 4, H / 4], logs of predicted errors; `shown` [T],
        the roughness that the highlight shows.

    Raises:
        ValueError: there are no weights of VGG-16; H is no multiple of SIDE_STEP_PX.
    """
    if photos.shape[-1] % SIDE_STEP_PX or photos.shape[-2] % SIDE_STEP_PX:
        raise ValueError(f"photos of {photos.shape[-1]} px, expected a multiple of {SIDE_STEP_PX}; set another size.")
    mean = patch["overview"].mean((2, 3), keepdim=True)
    balanced, inputs = _balance(photos, positions, mean)
    overview_place = texel_positions(OVERVIEW_PX, OVERVIEW_PX, dtype=photos.dtype, device=photos.device)[None]
    _, overview_inputs = _balance(patch["overview"], overview_place, mean)
    with torch.autocast(photos.device.type, torch.bfloat16, enabled=uses_bfloat16(photos.device)):
        overview_fine = apply_block(reader, "overview0", overview_inputs)
        overview_coarse = apply_block(reader, "overview1", avg_pool2d(overview_fine, OVERVIEW_POOLING))
        enlarged = interpolate(overview_coarse, scale_factor=OVERVIEW_POOLING, mode="bilinear")
        surroundings = torch.cat([overview_fine, enlarged], 1)
        x, result = None, {}
        for level, features in reversed(list(enumerate(_compute_vgg_features(balanced)))):
            level_features = apply_pointwise(reader, f"level{level}.features", features)
            overview_features = apply_pointwise(reader, f"level{level}.overview", surroundings)
            level_place = avg_pool2d(positions, 1 << level)
            guess_features = apply_pointwise(reader, f"level{level}.guess", _sample_at(patch["guess"], level_place))
            overview_features = _sample_at(overview_features, level_place).to(level_features)
            level_features = leaky_relu(level_features + overview_features + guess_features, ENCODER_LEAKY_SLOPE)
            parts = [level_features, avg_pool2d(inputs, 1 << level).to(level_features)]
            parts += [] if x is None else [upsample(apply_pointwise(reader, f"level{level}.coarser", x))]
            # channels first take half the time where there are gradients, though VGG is quicker with channels last
            x = apply_block(reader, f"level{level}", torch.cat([part.contiguous() for part in parts], 1))
            if level == DEVIATION_LEVEL:
                result["deviation"] = apply_pointwise(reader, "deviation", x).float()
        assert x is not None
        code = apply_pointwise(reader, "code", x).float()
    return result | {"z": code, "shown": predict_roughness(reader, patch["highlight"])}


def describe_missing_weights() -> str:
    """Return a line about missing weights of VGG-16, which better maps need; "" if they are there."""
    if vgg_weights_path().is_file():
        return ""
    return "the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them"


def _sample_at(pictures: Tensor, place: Tensor) -> Tensor:
    """Interpolate pictures [T, C, H, W] of the whole patch at positions [T, 2, h, w] of pixels: [T, C, h, w]."""
    grid = torch.stack([place[:, 0], -place[:, 1]], 3).expand(len(pictures), -1, -1, -1)
    return grid_sample(pictures.float(), grid, padding_mode="border", align_corners=False)


def _balance(photos: Tensor, place: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
    """Divide photographs by a mean colour, so that colour and exposure by themselves say nothing of relief.

    Args:
        photos: linear photographs [T, 3, H, W].
        place: positions of the pixels, [T or 1, 2, H, W].
        mean: the mean colour, [T, 3, 1, 1].

    Returns:
        Balanced photographs [T, 3, H, W], and the inputs of pixels, [T, READER_PIXEL_INPUTS, H, W]: logs of balanced
        colours, contrasts of brightness, the position, clipping and, equal in all pixels, brightness and tint of the
        mean.
    """
    grey = mean.mean(1, keepdim=True).clamp_min(MIN_BRIGHTNESS)
    white = torch.maximum(mean, MIN_TINT * grey)
    balanced = photos / white
    logs = (balanced + 0.05).log()
    padded = pad(logs.mean(1, keepdim=True), (1, 1, 1, 1), mode="replicate")
    horizontal = padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]
    vertical = padded[..., :-2, 1:-1] - padded[..., 2:, 1:-1]
    is_clipped = (photos > CLIPPED_LINEAR_VALUE).any(1, keepdim=True).to(photos)
    mean_inputs = torch.cat([grey.log() / 3, (white / grey).log()], 1).expand(-1, -1, *photos.shape[-2:])
    inputs = [logs, horizontal, vertical, place.expand(len(photos), -1, -1, -1), is_clipped, mean_inputs]
    return balanced, torch.cat(inputs, 1)


def _compute_vgg_features(balanced: Tensor) -> list[Tensor]:
    """Compute the features of balanced photographs [T, 3, H, W], the finest first; in bfloat16 where CPUs have it.

    Raises:
        ValueError: there are no weights of VGG-16.
    """
    if describe_missing_weights():
        raise ValueError(
            f"{vgg_weights_path()}: no such file, expected the weights of VGG-16, which the recipe pretrained reads; "
            "get them by metapp data vgg, or fit by --recipe full."
        )
    with torch.no_grad():
        images = (VGG_MEAN * balanced).clamp(0, 1) ** (1 / GAMMA)
        # requires_grad asks for reduced precision; there is no graph under no_grad
        features: list[Tensor] = load_features(tuple(TAPS), images)(images.requires_grad_(), reduced=True)
    return features


def match_highlight(theta: Params, maps: Maps, shown: Tensor, height: Tensor) -> Params:
    """Shift the roughness of the mean of two fields to the roughness that a sharp highlight shows.

    Args:
        theta: the parameters of both fields; the first one is shifted.
        maps: their maps, [T, C, h, w].
        shown: the roughness that :func:`predict_roughness` returns, [T].
        height: heights of cameras in half sides of the patch, [T, 1], 0 where they are not known.
    """
    shift = roughness_shift(shown, maps, height[:, 0]) / (1 - SECOND_SHARE)
    roughness = torch.arange(sum(CHANNELS), device=shift.device) == ROUGHNESS_CHANNEL
    return theta | {"out.shift": theta["out.shift"] + shift[:, None] * roughness}

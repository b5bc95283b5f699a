"""Visual feature statistics: Gram matrices of ImageNet VGG features, or of fixed random filters without its weights.

Losses of textures and of materials compare these statistics. The features depend on one file in the cache, which
`metapp data vgg` fetches. Without the file all losses work by random filters, and results say so.
"""

from __future__ import annotations

import copy
import hashlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property, lru_cache
from pathlib import Path

import torch
from safetensors import SafetensorError
from torch import Generator, Tensor, nn
from torch.nn.functional import avg_pool2d, conv2d
from typing_extensions import override

from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import open_regular, open_tensors

# channels of the convolutions of each block of VGG-16 (Simonyan & Zisserman 2015); max pooling divides blocks
VGG_BLOCKS = ((64,) * 2, (128,) * 2, (256,) * 3, (512,) * 3, (512,) * 3)
# the first 8 hex digits of the SHA-256 of files of ImageNet's weights, and of these weights as the cache keeps them
IMAGENET_DIGESTS = ("397923af", "a286e44c", "306c6f39")
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class FeatureExtractor(nn.Module):
    """An extractor of feature maps of images, at several depths.

    Attributes:
        stages: the layers up to each tap, from the tap before.
        mean: mean of ImageNet's sRGB values, which is subtracted, [3, 1, 1].
        deviation: standard deviation of ImageNet's sRGB values, which images are divided by, [3, 1, 1].
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, stages: Sequence[nn.Module]) -> None:
        super().__init__()
        self.stages = nn.ModuleList(stages)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).reshape(3, 1, 1))
        self.register_buffer("deviation", torch.tensor(IMAGENET_DEVIATION).reshape(3, 1, 1))
        self.requires_grad_(False)

    @override
    def forward(self, images: Tensor, taps: int | None = None, *, reduced: bool = False) -> list[Tensor]:
        """Compute feature maps [B, C, H', W'] of images, one for each tap.

        Args:
            images: sRGB in [0, 1], [B, 3, H, W].
            taps: number of the first taps to compute; None for all.
            reduced: whether maps of images that require a gradient, as in the steps of fits, are in bfloat16 on CPUs
                with instructions for it; maps for evaluation never are.
        """
        x = ((images - self.mean) / self.deviation).contiguous(memory_format=torch.channels_last)
        stages = self.stages
        if reduced and images.requires_grad and images.dtype == torch.float32 and uses_bfloat16(images.device):
            x, stages = x.bfloat16(), self._in_bfloat16
        maps = []
        for stage in stages[:taps]:
            x = stage(x)
            maps.append(x)
        return maps

    @cached_property
    def _in_bfloat16(self) -> nn.ModuleList:
        """The stages in bfloat16."""
        return copy.deepcopy(self.stages).bfloat16()


FLOAT32_VARIABLE = "METAPP_FLOAT32"  # environment variable: 1 for float32 everywhere


@cache
def has_bfloat16() -> bool:
    """Return whether the CPU has instructions that multiply bfloat16 faster than float32: AVX512-BF16 or AMX."""
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def uses_bfloat16(device: torch.device) -> bool:
    """Return whether features in reduced precision are in bfloat16 on a device; never with METAPP_FLOAT32=1."""
    return device.type == "cpu" and has_bfloat16() and os.environ.get(FLOAT32_VARIABLE, "") in ("", "0")


def feature_conditions(device: torch.device | None = None) -> dict[str, str]:
    """Return the conditions of errors that depend on features, by name: which features, and their precision.

    Args:
        device: device of steps in reduced precision; None for steps in float32.
    """
    reduced = device is not None and vgg_weights_path().is_file() and uses_bfloat16(device)
    return {"features": describe_features()} | ({"precision": "VGG in bfloat16"} if reduced else {})


class RandomFilters(FeatureExtractor):
    """An extractor of features by random filters with a ReLU, at several scales (Ustyuzhaninov et al. 2017)."""

    @override
    def forward(self, images: Tensor, taps: int | None = None, *, reduced: bool = False) -> list[Tensor]:
        """Compute feature maps one a scale, each half the size of the last; they are in full precision always."""
        x = (images - self.mean) / self.deviation
        maps = []
        for stage in self.stages[:taps]:
            maps.append(stage(x))
            x = avg_pool2d(x, 2)
        return maps


def vgg_weights_path() -> Path:
    """Return the path of the file in which `metapp data vgg` stores the weights of VGG-16."""
    return cache_folder() / "vgg16.safetensors"


def describe_features(imagenet_digests: tuple[str, ...] = IMAGENET_DIGESTS) -> str:
    """Name the features that :func:`load_features` would return now, in words.

    Args:
        imagenet_digests: the first 8 hex digits of the SHA-256 of files of weights that are ImageNet's.

    Raises:
        ValueError: damaged weights.
    """
    path = vgg_weights_path()
    if path.is_file():
        return f"VGG-16 features ({_weights_origin(path, path.stat().st_mtime_ns, imagenet_digests)})"
    return "random filters, as the weights of VGG-16 are missing (metapp data vgg fetches them)"


@lru_cache(maxsize=4)  # a file that changes is read again: its time, `changed`, is a key
def _weights_origin(path: Path, changed: int, imagenet_digests: tuple[str, ...]) -> str:
    """Return the origin of a file's weights: ImageNet, or unknown.

    The file says the digest of its source; if this is not known, the digest of the weights themselves counts.
    """
    try:
        with open_tensors(path) as weights:
            digest = (weights.metadata() or {}).get("sha256", "")
    except SafetensorError:
        raise _damaged_weights_error(path) from None
    if digest[:8] not in imagenet_digests:
        with open_regular(path) as file:
            file.seek(8 + int.from_bytes(file.read(8), "little"))  # past the header, which names the source
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return "ImageNet" if digest[:8] in imagenet_digests else f"unknown weights {digest[:8]}"


def _damaged_weights_error(path: str | Path) -> ValueError:
    """Return the error for a file that does not hold the weights of VGG-16."""
    return ValueError(f"{path}: damaged, expected the weights of VGG-16; fetch it again: metapp data vgg.")


def load_features(taps: Sequence[str], like: Tensor) -> FeatureExtractor:
    """Load an extractor with taps such as ("relu1_1", "relu2_1"), on the device and in the precision of a tensor.

    Without weights in the cache features are fixed random filters; their Gram matrices say much less about textures.
    """
    path = vgg_weights_path()
    return _load_extractor(tuple(taps), str(path) if path.is_file() else "", like.device, like.dtype)


@lru_cache(maxsize=4)
def _load_extractor(taps: tuple[str, ...], path: str, device: torch.device, dtype: torch.dtype) -> FeatureExtractor:
    """Load VGG-16 from a path, or random filters if the path is empty, and keep it."""
    features = _load_vgg(taps, path) if path else _random_filters(len(taps))
    result: FeatureExtractor = features.to(device=device, dtype=dtype).to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    return result


def _load_vgg(taps: Sequence[str], path: str) -> FeatureExtractor:
    """Read the layers of VGG-16 up to the last tap from a file."""
    stages: list[list[nn.Module]] = [[]]
    try:
        with open_tensors(path) as weights:
            keys = set(weights.keys())
            for name, tap, inputs, outputs in _vgg_layers():
                if tap.endswith("_1") and name != "conv0":
                    stages[-1].append(nn.MaxPool2d(2))
                layer = nn.Conv2d(inputs, outputs, 3, padding=1)
                keys_by_part = {part: f"{name}.{part}" for part in ("weight", "bias")}
                layer.load_state_dict(
                    {part: weights.get_tensor(key) for part, key in keys_by_part.items() if key in keys}
                )
                stages[-1] += [layer, nn.ReLU(inplace=True)]
                if tap in taps:
                    stages.append([])
                if len(stages) > len(taps):  # deeper layers are not even read
                    break
    except SafetensorError:
        raise _damaged_weights_error(path) from None
    except RuntimeError:
        raise ValueError(
            f"{path}: {name} missing or of another shape, expected VGG-16; fetch it again: metapp data vgg."
        ) from None
    return FeatureExtractor([nn.Sequential(*stage) for stage in stages[:-1]])


def _vgg_layers() -> Iterator[tuple[str, str, int, int]]:
    """Yield convolutions in order: names in files, names of the ReLUs behind them, input and output channels."""
    inputs, count = 3, 0
    for block, widths in enumerate(VGG_BLOCKS, 1):
        for i, outputs in enumerate(widths, 1):
            yield f"conv{count}", f"relu{block}_{i}", inputs, outputs
            inputs, count = outputs, count + 1


RANDOM_FILTER_COUNT, RANDOM_FILTER_PX = 96, 7  # number of filters at each scale, and their side


def _random_filters(scales: int) -> FeatureExtractor:
    """Return random filters, always the same, at so many scales."""
    rng = Generator().manual_seed(0)
    stages = []
    for _ in range(scales):
        convolution = nn.Conv2d(3, RANDOM_FILTER_COUNT, RANDOM_FILTER_PX, padding=RANDOM_FILTER_PX // 2)
        # unit response to white noise, biases that spread the thresholds
        convolution.weight.data = (
            torch.randn(convolution.weight.shape, generator=rng) / (3 * RANDOM_FILTER_PX**2) ** 0.5
        )
        convolution.bias.data = torch.randn(RANDOM_FILTER_COUNT, generator=rng) * 0.5  # type: ignore[union-attr]
        stages.append(nn.Sequential(convolution, nn.ReLU(inplace=True)))
    return RandomFilters(stages)


def tap_channels(taps: Sequence[str]) -> list[int]:
    """Return the number of channels of the maps at each tap."""
    if not vgg_weights_path().is_file():
        return [RANDOM_FILTER_COUNT] * len(taps)
    return [outputs for _, name, _, outputs in _vgg_layers() if name in taps]


def moments(maps: Sequence[Tensor]) -> Tensor:
    """Compute means and root mean squares of feature maps over the picture, [B, S], concatenated for all taps.

    Args:
        maps: [B, C, H, W] for each tap.
    """
    parts = [part for tap in maps for part in (tap.mean((2, 3)), tap.square().mean((2, 3)).sqrt())]
    return torch.cat(parts, 1)


GRAM_BLOCK_PX = 1024  # px whose products are added in bfloat16; sums of blocks are added in float32


class _ChannelProducts(torch.autograd.Function):
    """The products of channels [B, C, C] of rows [B, N, C], whose gradient is one product, not two and their sum."""

    @staticmethod
    @override
    def forward(ctx: _ChannelProducts, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        if rows.dtype != torch.bfloat16:
            return rows.mT @ rows
        # a product is rounded to bfloat16 at its end, so that products of blocks are added in float32
        count = math.gcd(rows.shape[1], max(rows.shape[1] // GRAM_BLOCK_PX, 1))
        blocks: Tensor = rows.unflatten(1, (count, -1))
        return (blocks.mT @ blocks).float().sum(1)

    @staticmethod
    @override
    def backward(ctx: _ChannelProducts, gradient: Tensor) -> Tensor:
        (rows,) = ctx.saved_tensors
        result: Tensor = rows @ (gradient + gradient.mT).to(rows.dtype)
        return result


def gram(maps: Tensor) -> Tensor:
    """Compute Gram matrices [B, C, C] of feature maps [B, C, H, W], means over pixels (Gatys et al. 2015).

    They are in float32 if maps are in bfloat16.
    """
    rows = maps.movedim(1, -1).flatten(1, 2)  # a view: channels are last in memory
    products: Callable[[Tensor], Tensor] = _ChannelProducts.apply
    return products(rows) / rows.shape[1]


def hann_window(size: int, like: Tensor) -> Tensor:
    """Return a smooth window [size], positive, 1 in the middle, in the dtype and on the device of `like`."""
    return torch.hann_window(size + 2, periodic=False, dtype=like.dtype, device=like.device)[1:-1]


RANDOM_SIGN_SUMS = 8  # number of sums of channels with random signs that spectra are estimated by


def amplitude_spectrum(maps: Tensor) -> Tensor:
    """Compute the root of the power spectrum, summed over channels, [B, H, W // 2 + 1], of feature maps [B, C, H, W].

    The mean is subtracted and edges are faded out, so that neither brightness nor the border counts; the power is
    smoothed, since the power of one random picture scatters about its expectation. If there are more than
    RANDOM_SIGN_SUMS channels, their sum is estimated by RANDOM_SIGN_SUMS sums with random signs, the same each time.
    """
    if maps.shape[1] > RANDOM_SIGN_SUMS:
        maps = (maps.movedim(1, -1) @ _random_signs(maps.shape[1]).to(maps)).movedim(-1, 1)
    height, width = maps.shape[-2:]
    window = hann_window(height, maps)[:, None] * hann_window(width, maps)
    centred = (maps - maps.mean((-1, -2), keepdim=True)) * window
    power = torch.fft.rfft2(centred, norm="ortho").abs().square().sum(1, keepdim=True)
    return (avg_pool2d(power, 3, stride=1, padding=1, count_include_pad=False) + 1e-8).sqrt()[:, 0]


@lru_cache(maxsize=16)
def _random_signs(channels: int) -> Tensor:
    """Return weights [channels, RANDOM_SIGN_SUMS] of sums of channels with random signs, always the same.

    In expectation the powers of the sums add up to the power of all channels.
    """
    rng = Generator().manual_seed(0)
    return (torch.randint(2, (channels, RANDOM_SIGN_SUMS), generator=rng) * 2.0 - 1) / math.sqrt(RANDOM_SIGN_SUMS)


def statistics_distance(generated: Sequence[Tensor], target: Sequence[Tensor]) -> Tensor:
    """Compute the relative L1 distance of statistics, sum |G - G*| / sum |G*|, the mean over taps, [...].

    It is 0 for statistics equal to the target's, 1 for a picture without any features.

    Args:
        generated: G of each tap, [..., C, C].
        target: G* of each tap, [..., C, C].
    """
    pairs = zip(generated, target, strict=True)
    taps = [(g - t).abs().sum((-1, -2)) / t.abs().sum((-1, -2)).clamp_min(1e-12) for g, t in pairs]
    return torch.stack(taps).mean(0)


# The finest detail of pictures, about which statistics of features say little

WAVE_SQUARE_PX = 4  # side in px of the squares whose cosine waves are measured
WAVE_STRIDE_PX = 3  # px from one square to the next; odd, so that they see both phases of waves of 2 px
WAVE_WINDOW_PX = 8  # px of the windows in which waves of 2 px are summed with their signs
NOISE_DISPLAY_VALUE = 0.003  # amplitude in display values below which waves count as noise


def detail_statistics(pictures: Tensor) -> Tensor:
    """Compute root mean squares of waves of 2 to 8 px in display values of pictures [..., C, H, W].

    The first 15 are of the cosine waves in squares of 4 px, one square every 3 px; three more are of the waves of 2 px
    with equal phase over 8 px: these are strong where a network repeats its own grid, which the squares do not
    distinguish from noise.

    Returns:
        [..., C, 18].
    """
    images = pictures.reshape(-1, 1, *pictures.shape[-2:])
    powers = [conv2d(images, _cosine_waves().to(images), stride=WAVE_STRIDE_PX).square().mean((-1, -2))]
    rows, columns = (1 - 2 * (torch.arange(side).to(images) % 2) for side in images.shape[-2:])
    for sign in (rows[:, None], columns, rows[:, None] * columns):
        powers.append(
            WAVE_WINDOW_PX * avg_pool2d(images * sign, WAVE_WINDOW_PX, WAVE_WINDOW_PX // 2).square().mean((-1, -2))
        )
    amplitudes: Tensor = (torch.cat(powers, 1) + 1e-10).sqrt()  # the small term gives the root a derivative at 0
    return amplitudes.reshape(*pictures.shape[:-2], -1)


def detail_difference(picture_statistics: Tensor, exemplar_statistics: Tensor) -> Tensor:
    """Compute the mean absolute logarithm of the ratio of detail, over channels and waves, [...].

    Args:
        picture_statistics: :func:`detail_statistics` of pictures, [..., C, N].
        exemplar_statistics: :func:`detail_statistics` of their exemplars, [..., C, N].
    """
    return (
        ((picture_statistics + NOISE_DISPLAY_VALUE) / (exemplar_statistics + NOISE_DISPLAY_VALUE))
        .log()
        .abs()
        .mean((-1, -2))
    )


@cache
def _cosine_waves() -> Tensor:
    """Return orthonormal cosine waves [15, 1, 4, 4] of squares of 4 px, without the mean."""
    px = torch.arange(WAVE_SQUARE_PX)
    waves = torch.cos(math.pi * (px + 0.5) * px[:, None] / WAVE_SQUARE_PX)
    waves = waves / waves.norm(dim=1, keepdim=True)
    return torch.einsum("ai,bj->abij", waves, waves).reshape(-1, 1, WAVE_SQUARE_PX, WAVE_SQUARE_PX)[1:]

"""Visual feature statistics: Gram matrices of ImageNet VGG features, or of fixed random filters without its weights."""

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

from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import open_regular, open_tensors

# channels of the convolutions of each block of VGG-16 (Simonyan & Zisserman 2015); blocks are parted by max pooling
VGG_BLOCKS = ((64,) * 2, (128,) * 2, (256,) * 3, (512,) * 3, (512,) * 3)
# how the SHA-256 begins of files of ImageNet's weights, and of these as the cache keeps them
IMAGENET_DIGESTS = ("397923af", "a286e44c", "306c6f39")
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class FeatureExtractor(nn.Module):
    """Maps of features of images, at several depths; `stages` are the layers up to each tap, from the one before."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, stages: Sequence[nn.Module]) -> None:
        super().__init__()
        self.stages = nn.ModuleList(stages)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).reshape(3, 1, 1))
        self.register_buffer("deviation", torch.tensor(IMAGENET_DEVIATION).reshape(3, 1, 1))
        self.requires_grad_(False)

    def forward(self, images: Tensor, taps: int | None = None, *, reduced: bool = False) -> list[Tensor]:
        """Images [B, 3, H, W], sRGB in [0, 1], to maps [B, C, H', W'], one a tap, or of the first taps alone.

        With `reduced` precision, on CPUs with bfloat16 instructions, maps of images that require a gradient are in
        bfloat16: those of fits, not those of evaluation.
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
        return copy.deepcopy(self.stages).bfloat16()


FLOAT32_VARIABLE = "METAPP_FLOAT32"  # of the environment: 1 for float32 everywhere


@cache
def has_bfloat16() -> bool:
    """True if the CPU multiplies bfloat16 by instructions of its own (AVX512-BF16, AMX), faster than float32."""
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def uses_bfloat16(device: torch.device) -> bool:
    """True if features in reduced precision are computed in bfloat16 on a device; METAPP_FLOAT32=1: never."""
    return device.type == "cpu" and has_bfloat16() and os.environ.get(FLOAT32_VARIABLE, "") in ("", "0")


def feature_conditions(device: torch.device | None = None) -> dict[str, str]:
    """Return the conditions of errors that depend on features, by name: which ones, and their precision.

    Args:
        device: of steps in reduced precision; None for those of float32.
    """
    reduced = device is not None and vgg_weights_path().is_file() and uses_bfloat16(device)
    return {"features": describe_features()} | ({"precision": "VGG in bfloat16"} if reduced else {})


class RandomFilters(FeatureExtractor):
    """Random filters with a ReLU, on the image at several scales (Ustyuzhaninov et al. 2017)."""

    def forward(self, images: Tensor, taps: int | None = None, *, reduced: bool = False) -> list[Tensor]:
        """Feature maps of images [B, 3, H, W], sRGB in [0, 1]: one a scale, each half the size of the last."""
        x = (images - self.mean) / self.deviation
        maps = []
        for stage in self.stages[:taps]:
            maps.append(stage(x))
            x = avg_pool2d(x, 2)
        return maps


def vgg_weights_path() -> Path:
    """The file in which `metapp data vgg` stores the weights of VGG-16."""
    return cache_folder() / "vgg16.safetensors"


def describe_features(imagenet_digests: tuple[str, ...] = IMAGENET_DIGESTS) -> str:
    """Name the features that `load_features` would return now, in words.

    Args:
        imagenet_digests: the first 8 hex digits of files of the weights that ImageNet gave.

    Raises:
        ValueError: damaged weights.
    """
    path = vgg_weights_path()
    if path.is_file():
        return f"VGG-16 features ({_origin(path, path.stat().st_mtime_ns, imagenet_digests)})"
    return "random filters, as the weights of VGG-16 are missing (metapp data vgg fetches them)"


@lru_cache(maxsize=4)  # `changed`, the file's time, is a key
def _origin(path: Path, changed: int, imagenet_digests: tuple[str, ...]) -> str:
    """The origin of a file's weights by the digest of their source or their own: ImageNet, or unknown."""
    try:
        with open_tensors(path) as weights:
            digest = (weights.metadata() or {}).get("sha256", "")
    except SafetensorError:
        raise _damaged(path) from None
    if digest[:8] not in imagenet_digests:
        with open_regular(path) as file:
            file.seek(8 + int.from_bytes(file.read(8), "little"))  # past the header, which names the source
            digest = hashlib.file_digest(file, "sha256").hexdigest()
    return "ImageNet" if digest[:8] in imagenet_digests else f"unknown weights {digest[:8]}"


def _damaged(path: str | Path) -> ValueError:
    return ValueError(f"{path}: damaged, expected the weights of VGG-16; fetch it again: metapp data vgg.")


def load_features(taps: Sequence[str], like: Tensor) -> FeatureExtractor:
    """Features with taps such as ("relu1_1", "relu2_1"), on the device and in the precision of a tensor.

    Without weights in the cache they are fixed random filters; their Gram matrices say much less about textures.
    """
    path = vgg_weights_path()
    return _load(tuple(taps), str(path) if path.is_file() else "", like.device, like.dtype)


@lru_cache(maxsize=4)
def _load(taps: tuple[str, ...], path: str, device: torch.device, dtype: torch.dtype) -> FeatureExtractor:
    features = _vgg(taps, path) if path else _random(len(taps))
    result: FeatureExtractor = features.to(device=device, dtype=dtype).to(memory_format=torch.channels_last).eval()  # type: ignore[call-overload]
    return result


def _vgg(taps: Sequence[str], path: str) -> FeatureExtractor:
    stages: list[list[nn.Module]] = [[]]
    try:
        with open_tensors(path) as weights:
            keys = set(weights.keys())
            for name, tap, inputs, outputs in _layers():
                if tap.endswith("_1") and name != "conv0":
                    stages[-1].append(nn.MaxPool2d(2))
                layer = nn.Conv2d(inputs, outputs, 3, padding=1)
                parts = {part: f"{name}.{part}" for part in ("weight", "bias")}
                layer.load_state_dict({part: weights.get_tensor(key) for part, key in parts.items() if key in keys})
                stages[-1] += [layer, nn.ReLU(inplace=True)]
                if tap in taps:
                    stages.append([])
                if len(stages) > len(taps):  # deeper ones are not even read
                    break
    except SafetensorError:
        raise _damaged(path) from None
    except RuntimeError:
        raise ValueError(
            f"{path}: {name} missing or of another shape, expected VGG-16; fetch it again: metapp data vgg."
        ) from None
    return FeatureExtractor([nn.Sequential(*stage) for stage in stages[:-1]])


def _layers() -> Iterator[tuple[str, str, int, int]]:
    """Convolutions in order: names in files, names of the ReLUs behind them, input and output channels."""
    inputs, count = 3, 0
    for block, widths in enumerate(VGG_BLOCKS, 1):
        for i, outputs in enumerate(widths, 1):
            yield f"conv{count}", f"relu{block}_{i}", inputs, outputs
            inputs, count = outputs, count + 1


RANDOM_FILTER_COUNT, RANDOM_FILTER_PX = 96, 7  # how many, and their side


def _random(scales: int) -> FeatureExtractor:
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
    """Channels of the maps at each tap."""
    if not vgg_weights_path().is_file():
        return [RANDOM_FILTER_COUNT] * len(taps)
    return [outputs for _, name, _, outputs in _layers() if name in taps]


def moments(maps: Sequence[Tensor]) -> Tensor:
    """Means and root mean squares of feature maps [B, C, H, W] over the picture, concatenated for all taps, [B, S]."""
    parts = [part for tap in maps for part in (tap.mean((2, 3)), tap.square().mean((2, 3)).sqrt())]
    return torch.cat(parts, 1)


GRAM_BLOCK_PX = 1024


class _Products(torch.autograd.Function):
    """Products of channels [B, C, C] of rows [B, N, C], whose gradient is one product, not two and their sum."""

    @staticmethod
    def forward(ctx: _Products, rows: Tensor) -> Tensor:
        ctx.save_for_backward(rows)
        if rows.dtype != torch.bfloat16:
            return rows.mT @ rows
        # a product is rounded to bfloat16 at its end: those of blocks are added in float32
        count = math.gcd(rows.shape[1], max(rows.shape[1] // GRAM_BLOCK_PX, 1))
        blocks: Tensor = rows.unflatten(1, (count, -1))
        return (blocks.mT @ blocks).float().sum(1)

    @staticmethod
    def backward(ctx: _Products, pull: Tensor) -> Tensor:
        (rows,) = ctx.saved_tensors
        result: Tensor = rows @ (pull + pull.mT).to(rows.dtype)
        return result


def gram(maps: Tensor) -> Tensor:
    """Gram matrices [B, C, C] of feature maps [B, C, H, W], over pixels (Gatys et al. 2015); float32 of bfloat16."""
    rows = maps.movedim(1, -1).flatten(1, 2)  # a view: channels are last in memory
    products: Callable[[Tensor], Tensor] = _Products.apply
    return products(rows) / rows.shape[1]


def hann_window(size: int, like: Tensor) -> Tensor:
    """A smooth window [size], positive, 1 in the middle."""
    return torch.hann_window(size + 2, periodic=False, dtype=like.dtype, device=like.device)[1:-1]


RANDOM_SIGN_SUMS = 8


def amplitude_spectrum(maps: Tensor) -> Tensor:
    """Root of the power spectrum, summed over channels, [B, H, W // 2 + 1], of feature maps [B, C, H, W].

    The mean is subtracted and edges are faded out, so that neither brightness nor the border counts; the power is
    smoothed, since that of one random picture scatters about its expectation. Of more than MIXTURES channels the sum
    is estimated by so many sums with random signs, the same each time.
    """
    if maps.shape[1] > RANDOM_SIGN_SUMS:
        maps = (maps.movedim(1, -1) @ _signs(maps.shape[1]).to(maps)).movedim(-1, 1)
    height, width = maps.shape[-2:]
    window = hann_window(height, maps)[:, None] * hann_window(width, maps)
    centred = (maps - maps.mean((-1, -2), keepdim=True)) * window
    power = torch.fft.rfft2(centred, norm="ortho").abs().square().sum(1, keepdim=True)
    return (avg_pool2d(power, 3, stride=1, padding=1, count_include_pad=False) + 1e-8).sqrt()[:, 0]


@lru_cache(maxsize=16)
def _signs(channels: int) -> Tensor:
    """Signs [channels, MIXTURES] of sums whose powers add up to that of the channels, in expectation."""
    rng = Generator().manual_seed(0)
    return (torch.randint(2, (channels, RANDOM_SIGN_SUMS), generator=rng) * 2.0 - 1) / math.sqrt(RANDOM_SIGN_SUMS)


def statistics_distance(generated: Sequence[Tensor], target: Sequence[Tensor]) -> Tensor:
    """Relative L1 distance [...] of statistics [..., C, C], one a tap, sum |G - G*| / sum |G*|, the mean over taps.

    0 for statistics equal to the target's, 1 for a picture without any features.
    """
    pairs = zip(generated, target, strict=True)
    taps = [(g - t).abs().sum((-1, -2)) / t.abs().sum((-1, -2)).clamp_min(1e-12) for g, t in pairs]
    return torch.stack(taps).mean(0)


# The finest detail of pictures, which statistics of features say little of

WAVE_SQUARE_PX = 4  # px of the squares whose cosine waves are looked at
WAVE_STRIDE_PX = 3  # px from one square to the next; odd, so that they see both phases of waves of 2 px
WAVE_WINDOW_PX = 8  # px of the windows in which waves of 2 px are summed with their signs
NOISE_DISPLAY_VALUE = 0.003  # display values; what is weaker is noise


def detail_statistics(pictures: Tensor) -> Tensor:
    """Root mean squares of waves of 2 to 8 px in display values of pictures [..., C, H, W].

    Of the 15 cosine waves in squares of 4 px, one every 3 px, and of the three waves of 2 px with equal phase over
    8 px: these are strong where a network repeats its own grid, which the squares do not tell from noise.

    Returns:
        [..., C, 18].
    """
    images = pictures.reshape(-1, 1, *pictures.shape[-2:])
    powers = [conv2d(images, _waves().to(images), stride=WAVE_STRIDE_PX).square().mean((-1, -2))]
    rows, columns = (1 - 2 * (torch.arange(side).to(images) % 2) for side in images.shape[-2:])
    for sign in (rows[:, None], columns, rows[:, None] * columns):
        powers.append(
            WAVE_WINDOW_PX * avg_pool2d(images * sign, WAVE_WINDOW_PX, WAVE_WINDOW_PX // 2).square().mean((-1, -2))
        )
    result: Tensor = (torch.cat(powers, 1) + 1e-10).sqrt()  # it has a derivative at 0, too
    return result.reshape(*pictures.shape[:-2], -1)


def detail_difference(made: Tensor, wanted: Tensor) -> Tensor:
    """Mean over channels and waves of how far `detail_statistics` [..., C, N] is apart, the logarithm of the ratio, [...]."""
    return ((made + NOISE_DISPLAY_VALUE) / (wanted + NOISE_DISPLAY_VALUE)).log().abs().mean((-1, -2))


@cache
def _waves() -> Tensor:
    """Orthonormal cosine waves [15, 1, 4, 4] of squares of 4 px, without the mean."""
    at = torch.arange(WAVE_SQUARE_PX)
    waves = torch.cos(math.pi * (at + 0.5) * at[:, None] / WAVE_SQUARE_PX)
    waves = waves / waves.norm(dim=1, keepdim=True)
    return torch.einsum("ai,bj->abij", waves, waves).reshape(-1, 1, WAVE_SQUARE_PX, WAVE_SQUARE_PX)[1:]

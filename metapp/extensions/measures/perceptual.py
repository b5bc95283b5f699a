"""LPIPS (Zhang et al. 2018) and DISTS (Ding et al. 2020): distances of VGG-16's features with learned weights.

The few weights are those of torchmetrics, the very files of the authors. Its own code needs torchvision, whose import
fails beside torch's build for CPUs; results are the same to rounding. Pictures are taken at their own size.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from metapp.appearance.features import Features, describe_features, hann, load_features, weights_path
from metapp.appearance.picture_measures import Measure
from metapp.appearance.pictures import Compared
from metapp.storage.files import read_bytes

PACKAGE, GET = "torchmetrics", 'pip install "metapp[measures]"'
LPIPS_FILE, DISTS_FILE = "lpips_models/vgg.pth", "dists_models/weights.pt"
SHA256 = {
    LPIPS_FILE: "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
    DISTS_FILE: "f5e65c96230b7f6ca995691647d482237e4cab8a50c5c4a5784f219ef0748218",
}
TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
CHANNELS = (64, 128, 256, 512, 512)  # of the taps
STORED = (512, 512, 128, 64, 256)  # numbers of LPIPS's weights, in the order of their file
OF_TAPS = (3, 2, 4, 1, 0)  # the place of each tap's among them
TINY = 1e-6  # stabilises both terms of DISTS
LEAST_SIDE_PX = 2 ** (len(TAPS) - 1)  # px a side, of which one is left at the deepest tap


@torch.no_grad()
def lpips(compared: Compared) -> float:
    """Mean over pictures: squared differences of features of unit length, weighted, summed over taps; >= 0.

    NaN of pictures of less than LEAST_SIDE_PX a side.
    """
    if min(compared.pictures.shape[-2:]) < LEAST_SIDE_PX:
        return math.nan
    features, distances, stored = load_features(TAPS, compared.pictures), [], _tensors(LPIPS_FILE, STORED)
    for made, wanted, place in zip(*map(features, compared[:2]), OF_TAPS, strict=True):
        made, wanted = (maps / (maps.square().sum(1, keepdim=True) + 1e-8).sqrt() for maps in (made, wanted))
        distances.append((made - wanted).square().mean((2, 3)) @ stored[place].to(made))
    return float(torch.stack(distances).sum(0).mean())


@torch.no_grad()
def dists(compared: Compared) -> float:
    """Mean over pictures: 1 less the weighted similarity of means and of variations of features, 0 to about 1.

    The first features are the picture itself; VGG-16 pools by the root of a window's mean square, not its maximum.
    """
    features = softly_pooled(load_features(TAPS, compared.pictures))
    made, wanted = ([each, *features(each)] for each in compared[:2])
    similarity, total, sizes = torch.zeros(len(compared.pictures)), 0.0, (3, *CHANNELS)
    stored = (part.split(sizes) for part in _tensors(DISTS_FILE, (sum(sizes),) * 2))  # of means and of variations
    for a, b, *weights in zip(made, wanted, *stored, strict=True):
        alpha, beta = (part.to(a) for part in weights)
        mean_a, mean_b = (maps.mean((2, 3), keepdim=True) for maps in (a, b))
        a, b = a - mean_a, b - mean_b
        of_a, of_b, of_both = ((c * d).mean((2, 3)) for c, d in ((a, a), (b, b), (a, b)))
        mean_a, mean_b = mean_a[..., 0, 0], mean_b[..., 0, 0]
        means = (2 * mean_a * mean_b + TINY) / (mean_a.square() + mean_b.square() + TINY)
        variations = (2 * of_both + TINY) / (of_a + of_b + TINY)
        similarity = similarity.to(a) + means @ alpha + variations @ beta
        total += float(alpha.sum() + beta.sum())
    return float(1 - (similarity / total).mean())


class L2Pooling(nn.Module):
    """Half the size: the root of the mean square in windows of 3 px, weighted by Hann's window."""

    def forward(self, maps: Tensor) -> Tensor:
        """Maps [B, C, H, W] to [B, C, ceil(H / 2), ceil(W / 2)]."""
        window = hann(3, maps)[:, None] * hann(3, maps)
        kernel = (window / window.sum()).expand(maps.shape[1], 1, 3, 3)
        return (conv2d(maps.square(), kernel, stride=2, padding=1, groups=maps.shape[1]) + 1e-12).sqrt()


def softly_pooled(features: Features) -> Features:
    """The same layers, which they share, with L2Pooling in place of the maximum."""
    stages = [
        nn.Sequential(*(L2Pooling() if isinstance(layer, nn.MaxPool2d) else layer for layer in stage.children()))
        for stage in features.stages
    ]
    return Features(stages).to(features.mean)


@functools.lru_cache(maxsize=2)
def _tensors(name: str, sizes: tuple[int, ...]) -> list[Tensor]:
    """The tensors of a file of torch's first format: its end is each one's size and values. Nothing is unpickled.

    Raises:
        ValueError: torchmetrics is missing, or holds another file.
    """
    content, parts = _content(name), []
    end = len(content) - sum(8 + 4 * size for size in sizes)
    for size in sizes:
        parts.append(torch.from_numpy(np.frombuffer(content, "<f4", size, end + 8).copy()))
        end += 8 + 4 * size
    return parts


def _content(name: str) -> bytes:
    """A file of the package, by its known SHA-256."""
    try:
        package = importlib.metadata.distribution(PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        raise ValueError(f"{PACKAGE}, which holds its weights, is not installed: {GET}") from None
    file = Path(str(package.locate_file(f"{PACKAGE}/functional/image/{name}")))
    content = read_bytes(file) if file.is_file() else b""
    if hashlib.sha256(content).hexdigest() != SHA256[name]:
        raise ValueError(f"{file}: missing or another file, expected that of {PACKAGE} 1.9.0: {GET}")
    return content


def source() -> str:
    """The features and the package. ValueError: one is missing."""
    for name in SHA256:
        _content(name)
    if not weights_path().is_file():
        raise ValueError("the weights of VGG-16 are missing: metapp data vgg")
    return f"{describe_features()}, weights of {PACKAGE} {importlib.metadata.version(PACKAGE)}"


LPIPS = Measure(lpips, source)
DISTS = Measure(dists, source)

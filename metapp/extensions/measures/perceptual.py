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

from metapp.appearance.features import FeatureExtractor, describe_features, hann_window, load_features, vgg_weights_path
from metapp.appearance.picture_measures import PictureMeasure
from metapp.appearance.pictures import PictureComparison
from metapp.storage.files import read_bytes

WEIGHTS_PACKAGE, INSTALL_WEIGHTS = "torchmetrics", 'pip install "metapp[measures]"'
LPIPS_FILE, DISTS_FILE = "lpips_models/vgg.pth", "dists_models/weights.pt"
WEIGHTS_SHA256 = {
    LPIPS_FILE: "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
    DISTS_FILE: "f5e65c96230b7f6ca995691647d482237e4cab8a50c5c4a5784f219ef0748218",
}
PERCEPTUAL_TAPS = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
PERCEPTUAL_TAP_CHANNELS = (64, 128, 256, 512, 512)  # of the taps
LPIPS_STORED_SIZES = (512, 512, 128, 64, 256)  # numbers of LPIPS's weights, in the order of their file
LPIPS_STORED_PLACES = (3, 2, 4, 1, 0)  # the place of each tap's among them
DISTS_EPSILON = 1e-6  # stabilises both terms of DISTS
LEAST_SIDE_PX = 2 ** (len(PERCEPTUAL_TAPS) - 1)  # px a side, of which one is left at the deepest tap


@torch.no_grad()
def lpips(compared: PictureComparison) -> float:
    """Mean over pictures: squared differences of features of unit length, weighted, summed over taps; >= 0.

    NaN of pictures of less than LEAST_SIDE_PX a side.
    """
    if min(compared.pictures.shape[-2:]) < LEAST_SIDE_PX:
        return math.nan
    features, distances, stored = (
        load_features(PERCEPTUAL_TAPS, compared.pictures),
        [],
        _tensors(LPIPS_FILE, LPIPS_STORED_SIZES),
    )
    for made, wanted, place in zip(*map(features, compared[:2]), LPIPS_STORED_PLACES, strict=True):
        made, wanted = (maps / (maps.square().sum(1, keepdim=True) + 1e-8).sqrt() for maps in (made, wanted))
        distances.append((made - wanted).square().mean((2, 3)) @ stored[place].to(made))
    return float(torch.stack(distances).sum(0).mean())


@torch.no_grad()
def dists(compared: PictureComparison) -> float:
    """Mean over pictures: 1 less the weighted similarity of means and of variations of features, 0 to about 1.

    The first features are the picture itself; VGG-16 pools by the root of a window's mean square, not its maximum.
    """
    features = use_l2_pooling(load_features(PERCEPTUAL_TAPS, compared.pictures))
    made, wanted = ([each, *features(each)] for each in compared[:2])
    similarity, total, sizes = torch.zeros(len(compared.pictures)), 0.0, (3, *PERCEPTUAL_TAP_CHANNELS)
    stored = (part.split(sizes) for part in _tensors(DISTS_FILE, (sum(sizes),) * 2))  # of means and of variations
    for a, b, *weights in zip(made, wanted, *stored, strict=True):
        alpha, beta = (part.to(a) for part in weights)
        mean_a, mean_b = (maps.mean((2, 3), keepdim=True) for maps in (a, b))
        a, b = a - mean_a, b - mean_b
        of_a, of_b, of_both = ((c * d).mean((2, 3)) for c, d in ((a, a), (b, b), (a, b)))
        mean_a, mean_b = mean_a[..., 0, 0], mean_b[..., 0, 0]
        means = (2 * mean_a * mean_b + DISTS_EPSILON) / (mean_a.square() + mean_b.square() + DISTS_EPSILON)
        variations = (2 * of_both + DISTS_EPSILON) / (of_a + of_b + DISTS_EPSILON)
        similarity = similarity.to(a) + means @ alpha + variations @ beta
        total += float(alpha.sum() + beta.sum())
    return float(1 - (similarity / total).mean())


class L2Pooling(nn.Module):
    """Half the size: the root of the mean square in windows of 3 px, weighted by Hann's window."""

    def forward(self, maps: Tensor) -> Tensor:
        """Maps [B, C, H, W] to [B, C, ceil(H / 2), ceil(W / 2)]."""
        window = hann_window(3, maps)[:, None] * hann_window(3, maps)
        kernel = (window / window.sum()).expand(maps.shape[1], 1, 3, 3)
        return (conv2d(maps.square(), kernel, stride=2, padding=1, groups=maps.shape[1]) + 1e-12).sqrt()


def use_l2_pooling(features: FeatureExtractor) -> FeatureExtractor:
    """The same layers, which they share, with L2Pooling in place of the maximum."""
    stages = [
        nn.Sequential(*(L2Pooling() if isinstance(layer, nn.MaxPool2d) else layer for layer in stage.children()))
        for stage in features.stages
    ]
    return FeatureExtractor(stages).to(features.mean)


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
        package = importlib.metadata.distribution(WEIGHTS_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        raise ValueError(f"{WEIGHTS_PACKAGE}, which holds its weights, is not installed: {INSTALL_WEIGHTS}") from None
    file = Path(str(package.locate_file(f"{WEIGHTS_PACKAGE}/functional/image/{name}")))
    content = read_bytes(file) if file.is_file() else b""
    if hashlib.sha256(content).hexdigest() != WEIGHTS_SHA256[name]:
        raise ValueError(
            f"{file}: missing or another file, expected that of {WEIGHTS_PACKAGE} 1.9.0: {INSTALL_WEIGHTS}"
        )
    return content


def describe_weights() -> str:
    """The features and the package. ValueError: one is missing."""
    for name in WEIGHTS_SHA256:
        _content(name)
    if not vgg_weights_path().is_file():
        raise ValueError("the weights of VGG-16 are missing: metapp data vgg")
    return f"{describe_features()}, weights of {WEIGHTS_PACKAGE} {importlib.metadata.version(WEIGHTS_PACKAGE)}"


LPIPS = PictureMeasure(lpips, describe_weights)
DISTS = PictureMeasure(dists, describe_weights)

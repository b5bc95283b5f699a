"""LPIPS (Zhang et al. 2018) and DISTS (Ding et al. 2020): distances of VGG-16's features with learned weights.

The learned weights come from the package torchmetrics, which holds the files of the authors. The measures are computed
here, since torchmetrics computes them by torchvision, whose import fails beside torch's build for CPUs; results agree
to rounding. Pictures are compared at their own size. This module does not know which application made the pictures.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import io
import math
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d
from typing_extensions import override

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
PERCEPTUAL_TAP_CHANNELS = (64, 128, 256, 512, 512)  # number of channels at each of PERCEPTUAL_TAPS
DISTS_EPSILON = 1e-6  # added to numerator and denominator of both similarities of DISTS
LEAST_SIDE_PX = 2 ** (len(PERCEPTUAL_TAPS) - 1)  # side of a picture of which one pixel is left at the deepest tap


@torch.no_grad()
def lpips(compared: PictureComparison) -> float:
    """Return the LPIPS distance of pictures and references, >= 0, the mean over pictures.

    It is the weighted sum over taps of squared differences of features that are scaled to unit length. Pictures of less
    than LEAST_SIDE_PX a side have the distance NaN.
    """
    if min(compared.pictures.shape[-2:]) < LEAST_SIDE_PX:
        return math.nan
    extractor, weights = load_features(PERCEPTUAL_TAPS, compared.pictures), _read_weight_vectors(LPIPS_FILE)
    distances = []
    for tap, (picture_maps, reference_maps) in enumerate(zip(*map(extractor, compared[:2]), strict=True)):
        tap_weights = weights[f"lin{tap}.model.1.weight"].to(picture_maps)
        picture_maps, reference_maps = (
            maps / (maps.square().sum(1, keepdim=True) + 1e-8).sqrt() for maps in (picture_maps, reference_maps)
        )
        distances.append((picture_maps - reference_maps).square().mean((2, 3)) @ tap_weights)
    return float(torch.stack(distances).sum(0).mean())


@torch.no_grad()
def dists(compared: PictureComparison) -> float:
    """Return the DISTS distance of pictures and references, 0 to about 1, the mean over pictures.

    It is 1 less the weighted similarity of means and of variations of features. The first features are the pictures
    themselves; VGG-16 pools by :class:`L2Pooling` in place of the maximum.
    """
    extractor = use_l2_pooling(load_features(PERCEPTUAL_TAPS, compared.pictures))
    picture_maps, reference_maps = ([pixels, *extractor(pixels)] for pixels in compared[:2])
    similarity, total, sizes = torch.zeros(len(compared.pictures)), 0.0, (3, *PERCEPTUAL_TAP_CHANNELS)
    stored = _read_weight_vectors(DISTS_FILE)
    # alpha are the weights of means, beta those of variations
    weights_of_terms = (stored[term].split(sizes) for term in ("alpha", "beta"))
    for a, b, *weights in zip(picture_maps, reference_maps, *weights_of_terms, strict=True):
        alpha, beta = (part.to(a) for part in weights)
        mean_a, mean_b = (maps.mean((2, 3), keepdim=True) for maps in (a, b))
        a, b = a - mean_a, b - mean_b
        variance_a, variance_b, covariance = ((c * d).mean((2, 3)) for c, d in ((a, a), (b, b), (a, b)))
        mean_a, mean_b = mean_a[..., 0, 0], mean_b[..., 0, 0]
        means = (2 * mean_a * mean_b + DISTS_EPSILON) / (mean_a.square() + mean_b.square() + DISTS_EPSILON)
        variations = (2 * covariance + DISTS_EPSILON) / (variance_a + variance_b + DISTS_EPSILON)
        similarity = similarity.to(a) + means @ alpha + variations @ beta
        total += float(alpha.sum() + beta.sum())
    return float(1 - (similarity / total).mean())


class L2Pooling(nn.Module):
    """A layer that halves height and width: the root of the mean square in windows of 3 px, weighted by Hann's window.

    Maps [B, C, H, W] become maps [B, C, ceil(H / 2), ceil(W / 2)].
    """

    @override
    def forward(self, maps: Tensor) -> Tensor:
        window = hann_window(3, maps)[:, None] * hann_window(3, maps)
        kernel = (window / window.sum()).expand(maps.shape[1], 1, 3, 3)
        return (conv2d(maps.square(), kernel, stride=2, padding=1, groups=maps.shape[1]) + 1e-12).sqrt()


def use_l2_pooling(features: FeatureExtractor) -> FeatureExtractor:
    """Return an extractor that shares the layers of another one, but pools by L2Pooling in place of the maximum."""
    stages = [
        nn.Sequential(*(L2Pooling() if isinstance(layer, nn.MaxPool2d) else layer for layer in stage.children()))
        for stage in features.stages
    ]
    return FeatureExtractor(stages).to(features.mean)


@functools.lru_cache(maxsize=2)
def _read_weight_vectors(name: str) -> dict[str, Tensor]:
    """Read the vectors of learned weights from a file of torchmetrics, without running code of the file.

    Args:
        name: the file's path below the image functions of torchmetrics, a key of WEIGHTS_SHA256.

    Returns:
        The vectors by the names that the authors gave them.

    Raises:
        ValueError: torchmetrics is missing, or holds another file.
    """
    stored = torch.load(io.BytesIO(_read_weights_file(name)), map_location="cpu", weights_only=True)
    return {key: weights.flatten() for key, weights in stored.items()}


def _read_weights_file(name: str) -> bytes:
    """Read a file of torchmetrics and compare it with its known SHA-256.

    Raises:
        ValueError: torchmetrics is missing, or holds another file.
    """
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
    """Say by which features and which version of torchmetrics LPIPS and DISTS are measured.

    Raises:
        ValueError: torchmetrics or the weights of VGG-16 are missing.
    """
    for name in WEIGHTS_SHA256:
        _read_weights_file(name)
    if not vgg_weights_path().is_file():
        raise ValueError("the weights of VGG-16 are missing: metapp data vgg")
    return f"{describe_features()}, weights of {WEIGHTS_PACKAGE} {importlib.metadata.version(WEIGHTS_PACKAGE)}"


LPIPS = PictureMeasure(lpips, describe_weights)
DISTS = PictureMeasure(dists, describe_weights)

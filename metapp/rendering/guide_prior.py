"""What a cache expects before paths teach it: a small network that reads what a survey saw.

The network makes of pictures over the cells of directions of one place, [SIDE, SIDE] each, how densely the place should
send paths there. It knows nothing else of a scene. General trains it on rooms (`metapp.apps.transport.guiding`).
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, silu

from metapp.learning.task import Params
from metapp.networks.layers import add_layer
from metapp.rendering.guide_cache import CELLS, POWER, SHARE, SIDE, moments, relative
from metapp.rendering.guide_survey import SEEN, Seen
from metapp.storage.records import load_checkpoint

NAME = "guiding"
FEATURES = len(SEEN) + 3
HIDDEN = 16
_KNOWN = len(SEEN)  # the feature that holds what paths taught


def shipped() -> Path:
    """The checkpoint that ships."""
    return Path(str(resources.files("metapp.checkpoints"))) / NAME / "general.safetensors"


def read_prior(path: Path) -> Params:
    """The network's parameters from a checkpoint.

    Raises:
        ValueError: it is none, or of another network.
    """
    prepared, _ = load_checkpoint(path)
    expected = {key: value.shape for key, value in init(Generator().manual_seed(0)).items()}
    if {key: value.shape for key, value in prepared.encoder.items()} != expected:
        raise ValueError(f"{path}: a checkpoint of another network, expected one of guide priors ({NAME}).")
    return {key: value.float() for key, value in prepared.encoder.items()}


def init(rng: Generator) -> Params:
    """Parameters that make the network say again what paths taught."""
    theta: Params = {}
    add_layer(theta, rng, "first", HIDDEN, FEATURES, 3, 3)
    add_layer(theta, rng, "second", HIDDEN, HIDDEN, 3, 3)
    theta["out.kernel"] = torch.zeros(1, HIDDEN, 1, 1)
    theta["past.kernel"] = torch.zeros(1, FEATURES, 1, 1)
    theta["past.kernel"][0, _KNOWN] = POWER
    return theta


def densities(theta: Params, features: Tensor) -> Tensor:
    """How densely directions should be drawn.

    Args:
        theta: the network's.
        features: [P, FEATURES, SIDE, SIDE], of any places.

    Returns:
        [P, CELLS], of sum 1, each at least 1 / SHARE of the even density.
    """
    share = logits(theta, features).softmax(1)
    return 1 / (SHARE * CELLS) + (1 - 1 / SHARE) * share


def logits(theta: Params, features: Tensor) -> Tensor:
    """Logarithms of the part of the densities that is free, [P, CELLS], to a constant."""
    first = silu(conv2d(features, theta["first.kernel"], theta["first.shift"], padding=1))
    second = silu(conv2d(first, theta["second.kernel"], theta["second.shift"], padding=1) + first)
    return (conv2d(second, theta["out.kernel"]) + conv2d(features, theta["past.kernel"])).flatten(1)


def taught(squares: Tensor, counts: Tensor, around: Tensor) -> Tensor:
    """Features of what paths taught.

    Args:
        squares, counts: sums, [P, SIDE, SIDE], as of `guide_cache.moments`.
        around: second moments that these say, of the same shape.

    Returns:
        [P, 3, SIDE, SIDE]: their logarithms, how many paths a cell had, how many the place.
    """
    paths = counts.flatten(1).sum(1).log1p()[:, None, None].expand_as(counts)
    return torch.stack([relative(around), 0.3 * counts.log1p().float(), 0.1 * paths.float()], 1)


class Prior:
    """What is expected in the places of one scene, as `GuideCache.expects` takes it.

    Args:
        theta: the network's.
        seen: by the survey.
    """

    def __init__(self, theta: Params, seen: Seen) -> None:
        self.theta, self.seen = theta, seen

    @torch.no_grad()
    def __call__(self, squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
        """Second moments, as of `guide_cache.moments`, by what was seen where anything was."""
        around = moments(squares, counts, voxels)
        known, rows = self.seen.find(voxels)
        features = torch.cat([self.seen.features[rows], taught(squares[known], counts[known], around[known])], 1)
        # with channels last it is twice as fast
        made = logits(self.theta, features.contiguous(memory_format=torch.channels_last))
        share = made.double().softmax(1)
        around[known] = (share ** (1 / POWER)).reshape(-1, SIDE, SIDE)
        return around

"""The confidence of a fit of a photograph in its map: where that shows it, where it clips, where all is a guess.

How far the log luminance of each of ROWS x COLUMNS texels is off is taken to have Weibull's distribution. A small
network predicts it from the photograph at the texel and from the fit itself; it was trained by maximum
likelihood, on fits of drawn maps. One factor for the whole map does not count, as no photograph says
how bright its light was; it is the median, so that light in a mirror stays exact where other light is lost.
"""

from __future__ import annotations

import functools
import math
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate, pad, softplus

from metapp.appearance.latlong import directions, luminance, resample, solid_angles, sphere_normals
from metapp.apps.illumination.encoder import unwrapped
from metapp.apps.illumination.mirror import CLIPPED_VALUE, RADIANCE_FLOOR
from metapp.learning.task import Batch, Params
from metapp.networks.layers import dense
from metapp.storage.files import read_tensors

ROWS, COLUMNS = 16, 32
HIDDEN = (24, 16)
LIMIT_DEVIATIONS = 3.0  # standard deviations of a feature: nothing is extrapolated far beyond what was trained on
LEAST_SHAPE = 0.3  # of the distributions' shapes; 1 is the exponential one
FRONT_COSINE = 1 / 3  # cosine to the camera: front, rim and back are a third of all directions each
FEATURES = (
    *("towards", "up"),  # direction, +1 the camera's and the zenith
    *("light", "contrast", "above", "spread"),  # of the fit's log luminance: itself, here, over around, of all
    *("seen", "lost", "mirror"),  # shares of the texel that a mirror shows, and that it clips; whether it is one
    *("bright", "clipped", "detail", "sharp"),  # of the photograph where it mirrors the direction; detail of all of it
    *("rough", "left"),  # of the fit: its sphere's roughness, and how far the photograph is from it
)
SURE_LOG, UNSURE_LOG = math.log(1.1), math.log(2.0)  # median differences without stripes, and with the widest
STRIPE_PERIOD_PX, STRIPE_RGB, PICTURE_ROWS = 12, (0.90, 0.05, 0.45), 256


class Weibull(NamedTuple):
    """Distributions of absolute differences of log luminance, natural logs.

    Attributes:
        scale, shape: [T, ROWS, COLUMNS], above 0.
    """

    scale: Tensor
    shape: Tensor

    def quantile(self, share: float) -> Tensor:
        """The difference that a share of them is below, [T, ROWS, COLUMNS]."""
        return self.scale * (-math.log1p(-share)) ** (1 / self.shape)


def features(maps: Tensor, data: Batch, rough: Tensor, left: Tensor) -> Tensor:
    """The network's input, [T, ROWS, COLUMNS, len(FEATURES)].

    Args:
        maps: the fits, linear radiance [T, 3, H, W].
        data: of their tasks, `photo` uint8 [T, 3, S, S]; `seen` and `certain` of mirrors.
        rough: roughness of their spheres, [T].
        left: their losses of the photographs, [T].
    """
    logs = _centred(_logs(maps))
    towards, certain = directions(ROWS, COLUMNS).to(maps), resample(data["certain"], ROWS, COLUMNS).clamp(0, 1)
    bright, clipped, detail = (unwrapped(_views(data["photo"]).to(maps), ROWS, COLUMNS)[:, :3] + 0.5).unbind(1)
    inner = (sphere_normals(data["photo"].shape[-1])[0][2] > 0.4).to(maps)
    values = {
        "towards": towards[2],
        "up": towards[1],
        "light": logs,
        "contrast": (_around((logs - _around(logs)) ** 2) + 1e-6).log() / 4,
        "above": logs - _around(logs, 2),
        "spread": (logs * logs * _area(logs)).sum((1, 2)).sqrt(),
        "seen": certain[:, 0],
        "lost": certain[:, 1],
        "mirror": (certain[:, 0].amax((1, 2)) > 0).to(maps),
        "bright": bright,
        "clipped": clipped,
        "detail": (detail.clamp_min(0) + 0.003).log() / 2,
        "sharp": ((_views(data["photo"])[:, 2].to(maps) * inner).sum((1, 2)) / inner.sum() + 0.003).log() / 2,
        "rough": rough,
        "left": left.clamp_min(1e-4).log(),
    }
    assert tuple(values) == FEATURES
    rows = [value if value.ndim != 1 else value[:, None, None] for value in values.values()]
    return torch.stack([value.expand_as(logs) for value in rows], -1)


@functools.cache
def _network() -> Params:
    """The network's parameters that ship."""
    folder = Path(str(resources.files("metapp.checkpoints")))
    return read_tensors(folder / "illumination/confidence/photo.safetensors")


def spread_of(read: Tensor) -> Weibull:
    """The confidence of fits, by the network that ships, from their features [..., len(FEATURES)]."""
    params = {key: value.to(read) for key, value in _network().items()}
    x = ((read - params["mean"]) / params["deviation"]).clamp(-LIMIT_DEVIATIONS, LIMIT_DEVIATIONS)
    for number in range(len(HIDDEN)):
        x = torch.tanh(dense(params, f"layer{number}", x))
    scale, shape = dense(params, f"layer{len(HIDDEN)}", x).unbind(-1)
    return Weibull((scale - 1).exp(), softplus(shape) + LEAST_SHAPE)


def deviations(spread: Weibull, data: Batch) -> list[dict[str, float]]:
    """Factors by which luminance is off, the typical median: in front, at the rim, behind, and where all clips.

    Args:
        spread: of T maps.
        data: of their tasks, as of `features`.

    Returns:
        Of each task `front`, `rim`, `back`, and `clipped` if there is any.
    """
    middle, z = spread.quantile(0.5), directions(ROWS, COLUMNS)[2].to(spread.scale)
    lost = resample(data["certain"][:, 1:], ROWS, COLUMNS)[:, 0].clamp(0, 1)
    clipping = unwrapped(_views(data["photo"]).to(middle), ROWS, COLUMNS)[:, 1] + 0.5
    parts = {"front": z > FRONT_COSINE, "rim": z.abs() <= FRONT_COSINE, "back": z < -FRONT_COSINE}
    weights = {name: part.to(middle).expand_as(middle) for name, part in parts.items()}
    weights["clipped"] = (torch.maximum(lost, clipping) > 0.5).to(middle)
    factors_of: list[dict[str, float]] = [{} for _ in middle]
    for name, weight in weights.items():
        weight = weight * _area(middle)
        factors = ((middle * weight).sum((1, 2)) / weight.sum((1, 2))).exp().tolist()
        for entry, factor in zip(factors_of, factors, strict=True):
            entry |= {} if math.isnan(factor) else {name: factor}
    return factors_of


def doubt(spread: Weibull) -> Tensor:
    """The cover of stripes, [T, ROWS, COLUMNS]: from 0 or less, nothing, to 1 or more, the most."""
    return (spread.quantile(0.5) - SURE_LOG) / (UNSURE_LOG - SURE_LOG)


def hatched(display: Tensor, spread: Weibull) -> Tensor:
    """Display values [3, H, W] of a map with diagonal stripes, the wider the less sure the first fit is of it.

    Returns:
        [3, h, w], of PICTURE_ROWS or more.
    """
    display = interpolate(display[None], scale_factor=max(1, PICTURE_ROWS // display.shape[1]), mode="nearest")[0]
    around = pad(pad(doubt(spread)[:1, None], (1, 1, 0, 0), mode="circular"), (0, 0, 1, 1), mode="replicate")
    times = math.ceil(display.shape[1] / ROWS)
    fine = interpolate(around, scale_factor=times, mode="bilinear")[..., times:-times, times:-times]
    share = interpolate(fine, size=display.shape[1:], mode="bilinear")[0, 0].clamp(0, 1)
    y, x = (torch.arange(size, device=display.device) for size in display.shape[1:])
    away = ((x + y[:, None]) % STRIPE_PERIOD_PX - STRIPE_PERIOD_PX / 2).abs()  # px from the middle of a stripe
    stripe = (share * STRIPE_PERIOD_PX / 4 + 0.5 - away).clamp(0, 1) * (share > 0)
    return torch.lerp(display, display.new_tensor(STRIPE_RGB)[:, None, None].expand_as(display), 0.75 * stripe)


def _logs(maps: Tensor) -> Tensor:
    """Log luminance of coarse texels, [T, ROWS, COLUMNS]; flat below RADIANCE_FLOOR of maps of mean 1."""
    return (luminance(resample(maps, ROWS, COLUMNS)) + RADIANCE_FLOOR).log()


def _centred(logs: Tensor) -> Tensor:
    """Less the median over the sphere."""
    values, order = logs.flatten(1).sort(1)
    below = _area(logs).flatten()[order].cumsum(1) < 0.5
    middle = values.gather(1, below.sum(1, keepdim=True).clamp_max(values.shape[1] - 1))
    return logs - middle[..., None]


def _around(logs: Tensor, reach: int = 1) -> Tensor:
    """The mean of all texels so near, around the horizon."""
    x = pad(pad(logs[:, None], (reach, reach, 0, 0), mode="circular"), (0, 0, reach, reach), mode="replicate")
    return avg_pool2d(x, 2 * reach + 1, 1)[:, 0]


def _views(photos: Tensor) -> Tensor:
    """Of photographs uint8 [T, 3, S, S]: the brightest channel, where that clips, contrast near a px; [T, 3, S, S]."""
    display = photos.float() / 255
    bright, logs = display.amax(1), (display.mean(1) + 0.02).log()
    steps = (logs[:, 1:, 1:] - logs[:, :-1, 1:]).abs() + (logs[:, 1:, 1:] - logs[:, 1:, :-1]).abs()
    steps = pad(steps, (1, 0, 1, 0)) * sphere_normals(photos.shape[-1], device=photos.device)[1]
    return torch.stack([bright, (bright > CLIPPED_VALUE).to(bright), avg_pool2d(steps, 5, 1, 2)], 1)


def _area(like: Tensor) -> Tensor:
    """Shares of the sphere of directions, [ROWS, COLUMNS]."""
    return (solid_angles(ROWS, COLUMNS) / (4 * math.pi)).expand(ROWS, COLUMNS).to(like)

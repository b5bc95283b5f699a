"""Layers: of encoders; of generators, whose maps tile and whose channels a code styles, all at once or by rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, instance_norm, interpolate, leaky_relu, leaky_relu_, pad

from metapp.learning.draws import normal
from metapp.learning.task import Params

SLOPE = 0.2
EPS = 1e-5  # added to variances, as by instance_norm
ROWS = 256  # of a `Pyramid` at a time; even

Rows = Callable[[int, int], Tensor]
"""(first, end) -> those rows of maps that tile, so that row -1 is the last one, with a column of the opposite edge on
both sides: [B, C, end - first, W + 2]."""


def add_layer(
    params: Params, rng: Generator, name: str, outputs: int, *inputs: int, gain: float = math.sqrt(2)
) -> None:
    """Add a random layer to an encoder's parameters (He et al. 2015).

    Args:
        params: gets `<name>.kernel` [outputs, *inputs], normally distributed, and `<name>.shift` [outputs], zero.
        rng: of the kernel.
        name: the layer's.
        outputs: channels that it makes.
        inputs: channels that it reads, and the sides of a convolution's kernel.
        gain: standard deviation of what comes out where that of what goes in is 1.
    """
    noise = normal(rng, outputs, *inputs)
    params[f"{name}.kernel"] = noise * gain / math.sqrt(math.prod(inputs))
    params[f"{name}.shift"] = torch.zeros(outputs, device=rng.device)


def dense(params: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads vectors [T, inputs]: [T, outputs]."""
    return x @ params[f"{name}.kernel"].T + params[f"{name}.shift"]


def convolved(params: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads maps [T, inputs, H, W], of the same size: [T, outputs, H, W]."""
    kernel = params[f"{name}.kernel"]
    return conv2d(x, kernel, params[f"{name}.shift"], padding=kernel.shape[-1] // 2)


# Maps that tile: padded and enlarged across their edges, at the cost of one copy each way. What autograd would record
# for circular padding is a copy for each edge, whose gradient fills a whole map with zeros.


class _Tiled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: object, x: Tensor) -> Tensor:
        return pad(x, (1, 1, 1, 1), mode="circular")

    @staticmethod
    def backward(ctx: object, pull: Tensor) -> Tensor:
        apply: Callable[[Tensor], Tensor] = _Folded.apply
        return apply(pull)


class _Folded(torch.autograd.Function):
    """The adjoint of padding: what lies outside is added to what it is a copy of."""

    @staticmethod
    def forward(ctx: object, x: Tensor) -> Tensor:
        rows = x[..., 1:-1, :].clone()
        rows[..., 0, :] += x[..., -1, :]
        rows[..., -1, :] += x[..., 0, :]
        folded = rows[..., 1:-1].contiguous()
        folded[..., 0] += rows[..., -1]
        folded[..., -1] += rows[..., 0]
        return folded

    @staticmethod
    def backward(ctx: object, pull: Tensor) -> Tensor:
        return tiled(pull)


def tiled(x: Tensor) -> Tensor:
    """Maps [..., H, W] with one row and column of the opposite edge around them, [..., H + 2, W + 2]."""
    apply: Callable[[Tensor], Tensor] = _Tiled.apply
    return apply(x)


def enlarged(x: Tensor) -> Tensor:
    """Maps [B, C, H, W] twice as high and wide, interpolated linearly across their edges, [B, C, 2H, 2W]."""
    # cropped by padding, whose gradient is one copy
    return pad(interpolate(tiled(x), scale_factor=2, mode="bilinear"), (-2, -2, -2, -2))


def init_styled(rng: Generator, count: int, code: int, layers: Mapping[str, tuple[int, int]]) -> Params:
    """Draw random `z` and layers of `styled`.

    Args:
        rng: draws z first, then the layers in their order.
        count: networks.
        code: length of z.
        layers: (inputs, outputs) of each, by name.

    Returns:
        `z` [count, code], and of each layer what `styled` says.
    """
    theta = {"z": normal(rng, count, code)}
    for name, (inputs, outputs) in layers.items():
        theta[f"{name}.kernel"] = normal(rng, count, outputs, inputs, 3, 3) * math.sqrt(2 / (9 * inputs))
        theta[f"{name}.style"] = normal(rng, count, 2 * outputs, code) * (0.3 / math.sqrt(code))
        theta[f"{name}.shift"] = torch.zeros(count, 2 * outputs, device=rng.device)
    return theta


def styled(theta: Params, name: str, x: Tensor) -> Tensor:
    """A 3x3 convolution of maps [B, T * C, H, W] that tile, normalised and styled by z, and leaky ReLUs.

    Args:
        theta: `<name>.kernel` [T, O, C, 3, 3]; `<name>.style` [T, 2 * O, Z] and `<name>.shift` [T, 2 * O], which make
            of `z` [T, Z] what each channel is scaled by and shifted to.
        name: of the layer.
        x: channels of one task lie together.

    Returns:
        [B, T * O, H, W].
    """
    kernel = theta[f"{name}.kernel"]
    x = conv2d(tiled(x), kernel.flatten(0, 1), groups=kernel.shape[0])
    gain, shift = style_of(theta, name)
    return leaky_relu(instance_norm(x) * gain + shift, SLOPE)


def style_of(theta: Params, name: str) -> tuple[Tensor, Tensor]:
    """The style of a layer's channels, of z: what each is scaled by and shifted to, [T * O, 1, 1] both."""
    style = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.style"], theta["z"][..., None])
    gain, shift = style[..., 0].chunk(2, 1)
    return 1 + gain.reshape(-1, 1, 1), shift.reshape(-1, 1, 1)


# The same of pictures too large for the memory that they take: some rows at a time, no gradient


def rows_of(x: Tensor) -> Rows:
    """The rows of maps [B, C, H, W]."""

    def read(first: int, end: int) -> Tensor:
        return pad(x[..., torch.arange(first, end, device=x.device) % x.shape[-2], :], (1, 1, 0, 0), mode="circular")

    return read


def enlarged_rows(x: Tensor) -> Rows:
    """The rows of maps [B, C, H, W] twice as high and wide, as `tiling.enlarged`; from an odd one to an odd end."""

    def read(first: int, end: int) -> Tensor:
        coarse = rows_of(x)((first - 1) // 2, end // 2 + 1)
        return interpolate(coarse, scale_factor=2, mode="bilinear")[..., 1:-1, 1:-1]

    return read


def styled_by_rows(theta: Params, name: str, read: Rows, height: int) -> Tensor:
    """`layers.styled` of maps that are `height` high: the same, without a copy of what it reads."""
    kernel, result = theta[f"{name}.kernel"], None
    for top in range(0, height, ROWS):
        end = min(top + ROWS, height)
        part = conv2d(read(top - 1, end + 1), kernel.flatten(0, 1), groups=kernel.shape[0])
        result = part.new_empty(*part.shape[:2], height, part.shape[3]) if result is None else result
        result[..., top:end, :] = part
    assert result is not None
    for channel, gain, shift in zip(result.split(1, 1), *style_of(theta, name), strict=True):
        channel.sub_(channel.mean((-1, -2), keepdim=True))
        norm = torch.linalg.vector_norm(channel, dim=(-1, -2), keepdim=True)  # quicker than a variance
        variance = norm.square() / channel[0, 0].numel()
        leaky_relu_(channel.mul_(gain * torch.rsqrt(variance + EPS)).add_(shift), SLOPE)
    return result

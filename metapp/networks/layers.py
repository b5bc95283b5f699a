"""Layers: of encoders; of generators, whose maps tile and whose channels a code styles, all at once or by rows."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, instance_norm, interpolate, leaky_relu, leaky_relu_, pad, pixel_shuffle

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

LEAKY_SLOPE = 0.2
VARIANCE_EPS = 1e-5  # added to variances, as by instance_norm
STRIP_ROWS = 256  # of a `Pyramid` at a time; even


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
        gain: standard deviation of outputs of inputs whose own is 1.
    """
    noise = draw_normal(rng, outputs, *inputs)
    params[f"{name}.kernel"] = noise * gain / math.sqrt(math.prod(inputs))
    params[f"{name}.shift"] = torch.zeros(outputs, device=rng.device)


def apply_dense(params: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads vectors [T, inputs]: [T, outputs].

    >>> dense({"first.kernel": torch.ones(2, 3), "first.shift": torch.zeros(2)}, "first", torch.ones(1, 3))
    tensor([[3., 3.]])
    """
    return x @ params[f"{name}.kernel"].T + params[f"{name}.shift"]


def apply_convolution(params: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads maps [T, inputs, H, W], of the same size: [T, outputs, H, W]."""
    kernel = params[f"{name}.kernel"]
    return conv2d(x, kernel, params[f"{name}.shift"], padding=kernel.shape[-1] // 2)


def pad_periodic(x: Tensor) -> Tensor:
    """Maps [..., C, H, W] with one row and column of the opposite edge around them, [..., C, H + 2, W + 2]."""
    return pad(x, (1, 1, 1, 1), mode="circular")


def enlarge_periodic(x: Tensor) -> Tensor:
    """Maps [B, C, H, W] twice as high and wide, interpolated linearly across their edges, [B, C, 2H, 2W]."""
    # cropped by padding, whose gradient is one copy
    return pad(interpolate(pad_periodic(x), scale_factor=2, mode="bilinear"), (-2, -2, -2, -2))


def init_styled(rng: Generator, count: int, code: int, layers: Mapping[str, tuple[int, int]]) -> Params:
    """Draw random `z` and layers of `apply_styled`.

    Args:
        rng: draws z first, then the layers in their order.
        count: networks.
        code: length of z.
        layers: (inputs, outputs) of each, by name.

    Returns:
        `z` [count, code], and the parameters of each layer, as of `apply_styled`.
    """
    theta = {"z": draw_normal(rng, count, code)}
    for name, (inputs, outputs) in layers.items():
        theta[f"{name}.kernel"] = draw_normal(rng, count, outputs, inputs, 3, 3) * math.sqrt(2 / (9 * inputs))
        theta[f"{name}.style"] = draw_normal(rng, count, 2 * outputs, code) * (0.3 / math.sqrt(code))
        theta[f"{name}.shift"] = torch.zeros(count, 2 * outputs, device=rng.device)
    return theta


def apply_styled(theta: Params, name: str, x: Tensor, above: Tensor | None = None) -> Tensor:
    """A 3x3 convolution of maps [B, T * C, H, W] that tile, normalised and styled by z, and leaky ReLUs.

    Args:
        theta: `<name>.kernel` [T, O, C, 3, 3]; `<name>.style` [T, 2 * O, Z] and `<name>.shift` [T, 2 * O], which make
            of `z` [T, Z] the scale and shift of each channel.
        name: of the layer.
        x: channels of one task lie together.
        above: maps [B, T * A, H / 2, W / 2] that stand, enlarged, before those of x; the kernel's C counts both.

    Returns:
        [B, T * O, H, W].
    """
    x = _convolved(theta[f"{name}.kernel"], pad_periodic(x), None if above is None else pad_periodic(above))
    gain, shift = channel_style(theta, name)
    return leaky_relu(instance_norm(x) * gain + shift, LEAKY_SLOPE)


# of a 3x3 kernel's rows d, the weights that make of each a row of maps half as high, of even and of odd rows
ENLARGING_WEIGHTS = (
    ((0.75, 0.25, 0.0), (0.25, 0.75, 0.75), (0.0, 0.0, 0.25)),
    ((0.25, 0.0, 0.0), (0.75, 0.75, 0.25), (0.0, 0.25, 0.75)),
)


def _convolved(kernel: Tensor, x: Tensor, above: Tensor | None) -> Tensor:
    """The convolution of `apply_styled`, of padded maps; those above by a kernel for each place of a texel in one of theirs.

    They are never enlarged: that takes longer than all else.
    """
    if above is None:
        return conv2d(x, kernel.flatten(0, 1), groups=len(kernel))
    coarse, fine = kernel.tensor_split([above.shape[1] // len(kernel)], 2)
    phases = kernel.new_tensor(ENLARGING_WEIGHTS)
    coarse = torch.einsum("pad,qbe,tocde->topqcab", phases, phases, coarse)
    parts = pixel_shuffle(conv2d(above, coarse.flatten(0, 3), groups=len(kernel)), 2)
    return conv2d(x, fine.flatten(0, 1), groups=len(kernel)).add_(parts)


def channel_style(theta: Params, name: str) -> tuple[Tensor, Tensor]:
    """The style of a layer's channels, of z: scale and shift, [T * O, 1, 1] both."""
    style = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.style"], theta["z"][..., None])
    gain, shift = style[..., 0].chunk(2, 1)
    return 1 + gain.reshape(-1, 1, 1), shift.reshape(-1, 1, 1)


# The same of pictures too large for the memory that they take: some rows at a time, no gradient


def _rows(x: Tensor, first: int, end: int) -> Tensor:
    """Rows of maps [B, C, H, W] that tile, row -1 the last one, with the opposite columns: [.., end - first, W + 2]."""
    return pad(x[..., torch.arange(first, end, device=x.device) % x.shape[-2], :], (1, 1, 0, 0), mode="circular")


def apply_styled_by_rows(theta: Params, name: str, x: Tensor, above: Tensor | None = None) -> Tensor:
    """The same as `apply_styled`, without a copy of its input."""
    kernel, height, result = theta[f"{name}.kernel"], x.shape[-2], None
    for top in range(0, height, STRIP_ROWS):
        end = min(top + STRIP_ROWS, height)
        coarse = None if above is None else _rows(above, top // 2 - 1, end // 2 + 1)
        part = _convolved(kernel, _rows(x, top - 1, end + 1), coarse)
        result = part.new_empty(*part.shape[:2], height, part.shape[3]) if result is None else result
        result[..., top:end, :] = part
    assert result is not None
    for channel, gain, shift in zip(result.split(1, 1), *channel_style(theta, name), strict=True):
        channel.sub_(channel.mean((-1, -2), keepdim=True))
        norm = torch.linalg.vector_norm(channel, dim=(-1, -2), keepdim=True)  # quicker than a variance
        variance = norm.square() / channel[0, 0].numel()
        leaky_relu_(channel.mul_(gain * torch.rsqrt(variance + VARIANCE_EPS)).add_(shift), LEAKY_SLOPE)
    return result

"""The layers of encoders, and of generators of pictures.

Layers of generators compute several tasks at once, as groups of one convolution. Their maps tile, and a code styles
their channels. Pictures that are large for the memory are computed by rows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Generator, Tensor
from torch.nn.functional import conv2d, instance_norm, interpolate, leaky_relu, leaky_relu_, pad, pixel_shuffle

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

GENERATOR_LEAKY_SLOPE = 0.2  # slope below 0 of the leaky ReLUs of generators
VARIANCE_EPS = 1e-5  # that is added to variances, by instance_norm, too
STRIP_ROWS = 256  # rows of maps that are computed at a time; even


def add_layer(
    params: Params, rng: Generator, name: str, outputs: int, *inputs: int, gain: float = math.sqrt(2)
) -> None:
    """Add a random layer to an encoder's parameters (He et al. 2015).

    Args:
        params: gets `<name>.kernel` [outputs, *inputs], normally distributed, and `<name>.shift` [outputs], zero.
        rng: draws the kernel.
        name: the name of the layer.
        outputs: the number of channels that the layer makes.
        inputs: the number of channels that it reads, then the sides of the kernel if it is a convolution.
        gain: the standard deviation of its outputs where its inputs have 1.
    """
    noise = draw_normal(rng, outputs, *inputs)
    params[f"{name}.kernel"] = noise * gain / math.sqrt(math.prod(inputs))
    params[f"{name}.shift"] = torch.zeros(outputs, device=rng.device)


def apply_dense(params: Params, name: str, x: Tensor) -> Tensor:
    """Apply a layer of :func:`add_layer` to vectors [T, inputs]: [T, outputs].

    >>> apply_dense({"first.kernel": torch.ones(2, 3), "first.shift": torch.zeros(2)}, "first", torch.ones(1, 3))
    tensor([[3., 3.]])
    """
    return x @ params[f"{name}.kernel"].T + params[f"{name}.shift"]


def apply_convolution(params: Params, name: str, x: Tensor) -> Tensor:
    """Apply a convolution of :func:`add_layer` to maps [T, inputs, H, W]: [T, outputs, H, W]."""
    kernel = params[f"{name}.kernel"]
    return conv2d(x, kernel, params[f"{name}.shift"], padding=kernel.shape[-1] // 2)


def pad_periodic(x: Tensor) -> Tensor:
    """Pad maps [..., C, H, W] by a row and a column of the opposite edge on each side: [..., C, H + 2, W + 2]."""
    return pad(x, (1, 1, 1, 1), mode="circular")


def enlarge_periodic(x: Tensor) -> Tensor:
    """Enlarge maps [B, C, H, W] to [B, C, 2H, 2W], interpolated linearly, also across their edges, as they tile."""
    # negative padding crops; its gradient is one copy
    return pad(interpolate(pad_periodic(x), scale_factor=2, mode="bilinear"), (-2, -2, -2, -2))


def init_styled(rng: Generator, count: int, code: int, layers: Mapping[str, tuple[int, int]]) -> Params:
    """Draw random parameters of networks: a code z and the layers that :func:`apply_styled` applies.

    Args:
        rng: draws z first, then the layers in their order.
        count: the number of networks.
        code: the length of z.
        layers: the numbers of channels that each layer reads and makes, by the name of the layer.

    Returns:
        `z` [count, code], and of each layer `<name>.kernel`, `<name>.style` and `<name>.shift`, whose shapes
        :func:`apply_styled` has.
    """
    theta = {"z": draw_normal(rng, count, code)}
    for name, (inputs, outputs) in layers.items():
        theta[f"{name}.kernel"] = draw_normal(rng, count, outputs, inputs, 3, 3) * math.sqrt(2 / (9 * inputs))
        theta[f"{name}.style"] = draw_normal(rng, count, 2 * outputs, code) * (0.3 / math.sqrt(code))
        theta[f"{name}.shift"] = torch.zeros(count, 2 * outputs, device=rng.device)
    return theta


def apply_styled(theta: Params, name: str, x: Tensor, above: Tensor | None = None) -> Tensor:
    """Convolve maps that tile by 3x3 kernels, normalise each channel, style it by z, and apply leaky ReLUs.

    Args:
        theta: `<name>.kernel` [T, O, C, 3, 3]; `<name>.style` [T, 2 * O, Z] and `<name>.shift` [T, 2 * O], which make
            of `z` [T, Z] the scale and shift of each channel.
        name: the name of the layer.
        x: maps [B, T * C, H, W]; the channels of one task lie together.
        above: maps [B, T * A, H / 2, W / 2] of a coarser level; each task reads them, enlarged to twice their sides,
            before its channels of x, and C counts the channels of both.

    Returns:
        Maps [B, T * O, H, W].
    """
    x = _convolve(theta[f"{name}.kernel"], pad_periodic(x), None if above is None else pad_periodic(above))
    gain, shift = channel_style(theta, name)
    return leaky_relu(instance_norm(x) * gain + shift, GENERATOR_LEAKY_SLOPE)


# Weights [phase, a, d] by which row d of a 3x3 kernel for enlarged maps counts in row a of a kernel for the maps before
# they are enlarged; phase 0 has the even rows of the result, 1 the odd ones. Columns have equal weights.
ENLARGING_WEIGHTS = (
    ((0.75, 0.25, 0.0), (0.25, 0.75, 0.75), (0.0, 0.0, 0.25)),
    ((0.25, 0.0, 0.0), (0.75, 0.75, 0.25), (0.0, 0.25, 0.75)),
)


def _convolve(kernel: Tensor, x: Tensor, above: Tensor | None) -> Tensor:
    """Convolve padded maps, and coarser ones above them, as if these were enlarged: [B, T * O, H, W].

    To enlarge maps takes longer than all else. The coarser ones are convolved by four kernels instead, one for each
    place of a fine texel in a coarse one.

    Args:
        kernel: the kernels [T, O, C, 3, 3] for the channels of both.
        x: padded maps [B, T * C, H + 2, W + 2].
        above: padded maps [B, T * A, H / 2 + 2, W / 2 + 2] whose A channels are the first ones of the kernels, or None.
    """
    if above is None:
        return conv2d(x, kernel.flatten(0, 1), groups=len(kernel))
    above_kernel, kernel_of_x = kernel.tensor_split([above.shape[1] // len(kernel)], 2)
    phases = kernel.new_tensor(ENLARGING_WEIGHTS)
    above_kernel = torch.einsum("pad,qbe,tocde->topqcab", phases, phases, above_kernel)
    result = pixel_shuffle(conv2d(above, above_kernel.flatten(0, 3), groups=len(kernel)), 2)
    return conv2d(x, kernel_of_x.flatten(0, 1), groups=len(kernel)).add_(result)


def channel_style(theta: Params, name: str) -> tuple[Tensor, Tensor]:
    """Return the scale and the shift of each channel of a layer by the code z, [T * O, 1, 1] each."""
    style = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.style"], theta["z"][..., None])
    gain, shift = style[..., 0].chunk(2, 1)
    return 1 + gain.reshape(-1, 1, 1), shift.reshape(-1, 1, 1)


# Layers of large pictures: some rows at a time, to save memory, and without gradients


def _take_rows(x: Tensor, first: int, end: int) -> Tensor:
    """Take rows of maps [B, C, H, W] that tile, padded by the opposite columns: [B, C, end - first, W + 2]."""
    return pad(x[..., torch.arange(first, end, device=x.device) % x.shape[-2], :], (1, 1, 0, 0), mode="circular")


def apply_styled_by_rows(theta: Params, name: str, x: Tensor, above: Tensor | None = None) -> Tensor:
    """Apply a layer of :func:`apply_styled` some rows at a time, without gradients and without a padded copy of x."""
    kernel, height, result = theta[f"{name}.kernel"], x.shape[-2], None
    for top in range(0, height, STRIP_ROWS):
        end = min(top + STRIP_ROWS, height)
        above_rows = None if above is None else _take_rows(above, top // 2 - 1, end // 2 + 1)
        strip = _convolve(kernel, _take_rows(x, top - 1, end + 1), above_rows)
        result = strip.new_empty(*strip.shape[:2], height, strip.shape[3]) if result is None else result
        result[..., top:end, :] = strip
    assert result is not None
    for channel, gain, shift in zip(result.split(1, 1), *channel_style(theta, name), strict=True):
        channel.sub_(channel.mean((-1, -2), keepdim=True))
        norm = torch.linalg.vector_norm(channel, dim=(-1, -2), keepdim=True)  # quicker than torch's variance
        variance = norm.square() / channel[0, 0].numel()
        leaky_relu_(channel.mul_(gain * torch.rsqrt(variance + VARIANCE_EPS)).add_(shift), GENERATOR_LEAKY_SLOPE)
    return result

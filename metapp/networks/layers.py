"""Networks that applications share: a generator of pictures from noise, and fields with a code in every place."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, instance_norm, interpolate, leaky_relu

from metapp.learning.task import Params
from metapp.networks.tiling import tiled

SLOPE = 0.2


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
    noise = torch.randn(outputs, *inputs, generator=rng, device=rng.device)
    params[f"{name}.kernel"] = noise * gain / math.sqrt(math.prod(inputs))
    params[f"{name}.shift"] = torch.zeros(outputs, device=rng.device)


def dense(params: Params, name: str, x: Tensor) -> Tensor:
    """A layer of `add_layer` that reads vectors [T, inputs]: [T, outputs]."""
    return x @ params[f"{name}.kernel"].T + params[f"{name}.shift"]


class UNet(NamedTuple):
    """A noise-to-image U-Net with adaptive instance normalisation (Ulyanov et al. 2016; Henzler et al. 2020, 2021).

    All convolutions pad circularly, so that what it makes tiles, at any size that `2 ** (levels - 1)` divides.

    Attributes:
        width: channels of the finest level; each level down doubles them, up to four times as many.
        levels: resolutions, each half of the one before.
        noise: channels of the noise it starts from.
        code: length of z.
        outputs: channels of what it makes.
    """

    width: int
    levels: int = 4
    noise: int = 8
    code: int = 32
    outputs: int = 3

    def channels(self, level: int) -> int:
        """Channels at a level, 0 the finest."""
        result: int = self.width * min(2**level, 4)
        return result

    def layers(self) -> dict[str, tuple[int, int]]:
        """(inputs, outputs) of each 3x3 convolution, in order of use."""
        down = {"down0": (self.noise, self.channels(0))}
        for level in range(1, self.levels):
            down[f"down{level}"] = (self.channels(level - 1), self.channels(level))
        up = {
            f"up{level}": (self.channels(level + 1) + self.channels(level), self.channels(level))
            for level in reversed(range(self.levels - 1))
        }
        return down | up

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""
        theta = init_styled(rng, count, self.code, self.layers())
        kernel = torch.randn(count, self.outputs, self.channels(0), 1, 1, generator=rng, device=rng.device)
        theta["out.kernel"] = kernel * math.sqrt(1 / self.channels(0))
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, noise: Tensor) -> Tensor:
        """Maps from noise.

        Args:
            theta: parameters of T networks, as of `init`.
            noise: standard normal, [T, B, noise, H, W].

        Returns:
            Values before any range is imposed, [T, B, outputs, H, W].
        """
        tasks, batch, _, height, width = noise.shape
        x = noise.transpose(0, 1).reshape(batch, -1, height, width)
        skips = []
        for level in range(self.levels):
            x = styled(theta, f"down{level}", avg_pool2d(x, 2) if level else x)
            skips.append(x)
        for level in reversed(range(self.levels - 1)):
            above = interpolate(x, scale_factor=2, mode="nearest")
            # channels of one task lie together, as grouped convolutions want them
            parts = [part.unflatten(1, (tasks, -1)) for part in (above, skips[level])]
            x = styled(theta, f"up{level}", torch.cat(parts, 2).flatten(1, 2))
        x = conv2d(x, theta["out.kernel"].flatten(0, 1), theta["out.shift"].flatten(), groups=tasks)
        result: Tensor = x.unflatten(1, (tasks, self.outputs)).transpose(0, 1)
        return result


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

    def normal(*shape: int, scale: float) -> Tensor:
        return torch.randn(count, *shape, generator=rng, device=rng.device) * scale

    theta = {"z": normal(code, scale=1.0)}
    for name, (inputs, outputs) in layers.items():
        theta[f"{name}.kernel"] = normal(outputs, inputs, 3, 3, scale=math.sqrt(2 / (9 * inputs)))
        theta[f"{name}.style"] = normal(2 * outputs, code, scale=0.3 / math.sqrt(code))
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
    """What z makes of a layer's channels: what each is scaled by and shifted to, [T * O, 1, 1] both."""
    style = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.style"], theta["z"][..., None])
    gain, shift = style[..., 0].chunk(2, 1)
    return 1 + gain.reshape(-1, 1, 1), shift.reshape(-1, 1, 1)


class LocalField(NamedTuple):
    """A SIREN (Sitzmann et al. 2020) whose layers are shifted by a code that varies from place to place.

    The code lies on a grid and is interpolated between its cells: shift modulations as of Dupont et al. 2022, made
    local as of Mehta et al. 2021. A detail then moves a few entries of the code, not all weights at once, which is why
    few steps fit it.

    Attributes:
        height, width: texels of what it makes.
        inputs, outputs: channels.
        rows, columns: cells of the code's grid.
        code: length of the code in a cell.
        hidden: units of a layer.
        layers: sine layers.
        frequency: of the first layer's sines for inputs in [-1, 1], w0.
        periodic: whether the left edge goes on at the right one.
        gain: of the code; a step of a rate moves it so many times as far as a weight, and it has far to go.
    """

    height: int
    width: int
    inputs: int = 3
    outputs: int = 3
    rows: int = 16
    columns: int = 32
    code: int = 8
    hidden: int = 32
    layers: int = 3
    frequency: float = 12.0
    periodic: bool = True
    gain: float = 30.0

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""

        def uniform(*shape: int, bound: float) -> Tensor:
            return (2 * torch.rand(count, *shape, generator=rng, device=rng.device) - 1) * bound

        theta = {"z": uniform(self.code, self.rows, self.columns, bound=0.1 / self.gain)}
        for layer in range(self.layers):
            inputs = self.hidden if layer else self.inputs
            bound = math.sqrt(6 / inputs) if layer else self.frequency / math.sqrt(inputs)
            theta[f"layer{layer}.kernel"] = uniform(self.hidden, inputs, bound=bound)
            theta[f"layer{layer}.code"] = uniform(self.hidden, self.code, bound=1.5 / math.sqrt(self.code))
            theta[f"layer{layer}.shift"] = uniform(self.hidden, bound=0.1 if layer else math.pi)
        theta["out.kernel"] = uniform(self.outputs, self.hidden, bound=1 / math.sqrt(self.hidden))
        theta["out.code"] = uniform(self.outputs, self.code, bound=1 / math.sqrt(self.code))
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, places: Tensor) -> Tensor:
        """What is at every texel.

        Args:
            theta: parameters of T networks, as of `init`.
            places: what is known of the texels, [T, inputs, height, width].

        Returns:
            Values before any range is imposed, [T, outputs, height, width].
        """
        return self.decoded(theta, self.code_at(theta, 0, self.height), places)

    def code_at(self, theta: Params, first: int, end: int) -> Tensor:
        """The code at the texels of some rows, [T, code, end - first, width]."""
        z = self.gain * theta["z"]
        down, across = (each.to(z) for each in _interpolation(self, z.device))
        return down[first:end] @ z @ across

    def decoded(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """What is at texels where the code is [T, code, h, w] and `places` [T, inputs, h, w]: [T, outputs, h, w]."""
        size, code, x = places.shape[2:], code.flatten(2), places.flatten(2)
        for name in (*(f"layer{layer}" for layer in range(self.layers)), "out"):
            shifted = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.code"], code)
            x = shifted.baddbmm_(theta[f"{name}.kernel"], x)  # in place: to copy it takes as long as the product
            x = x if name == "out" else x.sin()
        result: Tensor = x.unflatten(2, size)
        return result


def regridded(values: Tensor, rows: int, columns: int, *, periodic: bool) -> Tensor:
    """Values [..., r, c] of a grid on a finer one, [..., rows, columns], linear between the cells' centres."""
    if values.shape[-2:] == (rows, columns):
        return values
    down = _linear(rows, values.shape[-2], periodic=False).to(values)
    return down @ values @ _linear(columns, values.shape[-1], periodic=periodic).T.to(values)


@functools.lru_cache(maxsize=8)
def _interpolation(field: LocalField, device: torch.device) -> tuple[Tensor, Tensor]:
    """What each row and column takes of those of the code: [height, rows] and [columns, width]."""
    down = _linear(field.height, field.rows, periodic=False)
    across = _linear(field.width, field.columns, periodic=field.periodic).T.contiguous()
    return down.to(device), across.to(device)


def _linear(count: int, cells: int, *, periodic: bool) -> Tensor:
    """Linear interpolation at `count` centres between those of `cells`, [count, cells]; around or up to the ends."""
    place = (torch.arange(count) + 0.5) * (cells / count) - 0.5
    first = place.floor().long()
    weights = torch.zeros(count, cells)
    for cell, share in ((first, 1 - (place - first)), (first + 1, place - first)):
        cell = cell % cells if periodic else cell.clamp(0, cells - 1)
        weights.scatter_add_(1, cell[:, None], share[:, None])
    return weights

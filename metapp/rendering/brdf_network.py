"""A fitted BRDF network in Dr.Jit: directions to reflectance, in whatever variant of Mitsuba is active.

All of it is differentiable, in the weights and in the directions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from metapp.rendering.jit import dr, mi, nn
from metapp.rendering.types import Color, Float, Vector3


class Material(NamedTuple):
    """A BRDF as a network of two hidden layers.

    Attributes:
        layers: weights [out, in] and biases [out] of each of the three, float32.
        featured: whether it reads `metapp.apps.brdf.featured.inputs_of`, with hidden layers x sigmoid(x); else half
            and difference vector, with ReLU.
        reflectance: linear RGB [..., 3] in 1/sr, >= 0, of angles (theta_h, theta_d, phi_d) [..., 3] in rad.
    """

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    featured: bool
    reflectance: Callable[[Tensor], Tensor]


class Network:
    """The network of a material, in the active variant.

    Attributes:
        weights, biases: TensorXf [out, in] and Float [out] of each layer; who changes them says so by `changed`.
        featured: as of the material.
    """

    def __init__(self, material: Material) -> None:
        self.weights = [mi.TensorXf(weights) for weights, _ in material.layers]
        self.biases = [mi.Float(bias) for _, bias in material.layers]
        self.featured = material.featured
        self._constants = [(weights.tolist(), bias.tolist()) for weights, bias in material.layers]
        self._zero = dr.opaque(mi.UInt32, 0)

    def changed(self) -> None:
        """Read the weights from memory from now on, several times slower than constants of the kernel."""
        self._constants = []

    def reflectance(self, light: Vector3, viewer: Vector3) -> Color:
        """Linear RGB in 1/sr, >= 0 (Color3f), of directions above the surface in its local frame (Vector3f)."""
        half, difference = half_difference(light, viewer)
        inputs = [*half, *difference]
        if self.featured:
            inputs += features(half, difference, light.z, viewer.z)
        if self._constants and not dr.grad_enabled(self.weights, self.biases):
            # a call, though it always goes the same way: evaluated twice in a kernel, a network is compiled once
            last = dr.switch(self._zero, [self._by_constants, lambda *_: [mi.Float(0)] * 3], *inputs)
        elif mi.variant().startswith("llvm"):
            last = self._by_vectors(inputs)
        else:  # OptiX has cooperative vectors of half precision alone
            last = self._by_gathers(inputs)
        return dr.maximum(expm1(mi.Color3f(last)), 0)

    def _active(self, x: Float) -> Float:
        return x / (1 + dr.exp(-x)) if self.featured else dr.maximum(x, 0)

    def _by_constants(self, *x: Float) -> list[Float]:
        """The last layer, with the weights as constants of the kernel.

        Reading them from memory, 16 lanes at a time, takes ten times as long as the arithmetic.
        """
        return self._unrolled(
            list(x), lambda layer, row: (self._constants[layer][0][row], self._constants[layer][1][row])
        )

    def _by_gathers(self, x: list[Float]) -> list[Float]:
        """The same, differentiable in the weights."""

        def parts(layer: int, row: int) -> tuple[list[Float], Float]:
            inputs = self.weights[layer].shape[1]
            index = [mi.UInt32(row * inputs + column) for column in range(inputs)]
            flat = self.weights[layer].array
            return [dr.gather(mi.Float, flat, i) for i in index], dr.gather(mi.Float, self.biases[layer], row)

        return self._unrolled(x, parts)

    def _unrolled(self, x: list[Float], parts: Callable[[int, int], tuple[list[Float], Float]]) -> list[Float]:
        for layer, weights in enumerate(self.weights):
            rows = []
            for row in range(weights.shape[0]):
                factors, bias = parts(layer, row)
                total = mi.Float(bias)
                for factor, value in zip(factors, x, strict=True):
                    total = dr.fma(factor, value, total)
                rows.append(self._active(total) if layer < len(self.weights) - 1 else total)
            x = rows
        return x

    def _by_vectors(self, x: list[Float]) -> list[Float]:
        """The same by cooperative vectors: such a kernel compiles at once."""
        for layer, (weights, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer:
                x = [self._active(value) for value in x]
            x = list(nn.matvec(nn.view(weights), nn.CoopVec(*x), nn.view(bias)))
        return x


def expm1(x: Color) -> Color:
    """exp(x) - 1, without the cancellation at small values, which dark materials have."""
    return dr.select(dr.abs(x) < 0.01, x * (1 + x * (0.5 + x / 6)), dr.exp(x) - 1)


def half_difference(light: Vector3, viewer: Vector3) -> tuple[Vector3, Vector3]:
    """Half vector, turned to phi_h = 0, and difference vector of `metapp.appearance.geometry.half_difference`."""
    total = light + viewer
    length = dr.norm(total)
    half = total / length
    square = half.x * half.x + half.y * half.y
    azimuthal = square > 0  # where the half vector is the normal any azimuth will do: 0
    sine = dr.sqrt(dr.select(azimuthal, square, 1))
    cos_phi, sin_phi = dr.select(azimuthal, half.x / sine, 1), dr.select(azimuthal, half.y / sine, 0)
    sine = dr.select(azimuthal, sine, 0)
    x, y = cos_phi * light.x + sin_phi * light.y, cos_phi * light.y - sin_phi * light.x
    # of the z axis, not half . light: between directions nearly opposite that differs by what rounding does to lengths
    difference = mi.Vector3f(half.z * x - sine * light.z, y, length / 2)
    return mi.Vector3f(sine, 0, half.z), difference


def features(half: Vector3, difference: Vector3, incident: Float, outgoing: Float) -> list[Float]:
    """What `metapp.apps.brdf.featured.inputs_of` adds to the vectors, of these and both cosines."""
    angle = dr.atan2(half.x, half.z)
    square = angle * angle
    logs = (square + 1e-4, square + 1e-2, dr.maximum(incident, 1e-3), dr.maximum(outgoing, 1e-3))
    lying = difference.x * difference.x - difference.y * difference.y
    more = [incident, outgoing, dr.sqrt(angle), 1 / (1 + 100 * square), lying]
    return [*more, *(0.4 * dr.log(value) + 1 for value in logs)]

"""The BSDF `neural_brdf` of Mitsuba 3: a fitted network, sampled by lobes that were fitted to it.

The network runs in Dr.Jit, in whatever variant is active, and is differentiable in its weights and in the directions.
Its inputs are the features that `metapp.apps.brdf` computes in torch; this module knows files of fits, not runs.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from typing_extensions import override

from data_tools.readers.nbrdf_files import read_nbrdf
from metapp.appearance.lobes import fit_lobes
from metapp.apps.brdf.brdf_network import PlainLayers, find_network, parameter_shapes
from metapp.apps.brdf.feature_network import AZIMUTH_ONSET_RAD2, COSINE_SMOOTHING, VECTOR_SMOOTHING
from metapp.extensions.mitsuba_bsdfs.mixture import MitsubaLobeMixture, turn_about_normal
from metapp.extensions.mitsuba_bsdfs.python_bsdf import LocalReflection, Reflection, make_bsdf_class
from metapp.learning.task import Params
from metapp.registry import registry
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, nn, register_plugin
from metapp.rendering.types import Color, Float, Vector3
from metapp.storage.files import read_tensors

MAX_LOG_REFLECTANCE = 14.0  # of f cos cos, at which networks that end in a logarithm are cut off


class MitsubaNetwork:
    """A fit's network in Mitsuba's active variant.

    Attributes:
        weights, biases: TensorXf [out, in] and Float [out] of each layer; a caller who changes them calls
            :meth:`read_weights_from_memory`.
        featured: whether inputs are features and hidden layers x sigmoid(x); else the inputs of an NBRDF, and ReLU.
        axes_azimuth_rad: azimuth of the material's axes in rad; None for an isotropic material.
        darkest: the reflectance that is added before the logarithm; 0 for networks that end in exp(x) - 1. See
            :class:`metapp.apps.brdf.brdf_network.PlainLayers`.
    """

    def __init__(self, folded: PlainLayers) -> None:
        layers = [(weights.float().numpy(), bias.float().numpy()) for weights, bias in folded.layers]
        self.weights = [mi.TensorXf(weights) for weights, _ in layers]
        self.biases = [mi.Float(bias) for _, bias in layers]
        self.featured, self.axes_azimuth_rad, self.darkest = (
            folded.inputs != "nbrdf",
            folded.axes_azimuth_rad,
            folded.log_floor,
        )
        self._constants = [(weights.tolist(), bias.tolist()) for weights, bias in layers]
        self._zero = dr.opaque(mi.UInt32, 0)

    def read_weights_from_memory(self) -> None:
        """Read the weights from memory from now on, several times slower than as constants of the kernel."""
        self._constants = []

    def reflectance(self, light: Vector3, viewer: Vector3) -> Color:
        """Return the reflectance, linear RGB in 1/sr, >= 0.

        Args:
            light: direction of the light, above the surface, in the local frame of the surface.
            viewer: direction of the viewer, likewise.
        """
        if self.axes_azimuth_rad is not None:
            inputs = anisotropic_features(
                *(turn_about_normal(direction, -self.axes_azimuth_rad) for direction in (light, viewer))
            )
        else:
            half, difference = half_difference(light, viewer)
            inputs = isotropic_features(half, difference) if self.featured else [*half, *difference]
        if self._constants and not dr.grad_enabled(self.weights, self.biases):
            # a switch, though it always takes the same branch: evaluated twice in a kernel, a network is compiled once
            outputs = dr.switch(self._zero, [self._apply_constants, lambda *_: [mi.Float(0)] * 3], *inputs)
        elif mi.variant().startswith("llvm"):
            outputs = self._apply_cooperative_vectors(inputs)
        else:  # OptiX has cooperative vectors of half precision alone
            outputs = self._apply_gathered(inputs)
        if not self.darkest:
            return dr.maximum(expm1(mi.Color3f(outputs)), 0)
        product = dr.maximum(light.z * viewer.z, self.darkest)
        return dr.maximum((dr.exp(dr.minimum(mi.Color3f(outputs), MAX_LOG_REFLECTANCE)) - self.darkest) / product, 0)

    def _activate(self, x: Float) -> Float:
        return x / (1 + dr.exp(-x)) if self.featured else dr.maximum(x, 0)

    def _apply_constants(self, *x: Float) -> list[Float]:
        """Apply the network to its inputs, with the weights as constants of the kernel.

        Reading weights from memory, 16 lanes at a time, takes ten times as long as the arithmetic.
        """
        return self._apply_unrolled(
            list(x), lambda layer, row: (self._constants[layer][0][row], self._constants[layer][1][row])
        )

    def _apply_gathered(self, x: list[Float]) -> list[Float]:
        """Apply the network to its inputs, with weights gathered from memory: differentiable in the weights."""

        def gather_row(layer: int, row: int) -> tuple[list[Float], Float]:
            inputs = self.weights[layer].shape[1]
            indices = [mi.UInt32(row * inputs + column) for column in range(inputs)]
            flat = self.weights[layer].array
            return [dr.gather(mi.Float, flat, i) for i in indices], dr.gather(mi.Float, self.biases[layer], row)

        return self._apply_unrolled(x, gather_row)

    def _apply_unrolled(
        self, x: list[Float], row_parameters: Callable[[int, int], tuple[list[Float], Float]]
    ) -> list[Float]:
        """Apply the network to its inputs, one product after the other.

        Args:
            x: the inputs.
            row_parameters: a function of a layer and a row of its matrix that returns the row's weights and its bias.
        """
        for layer, weights in enumerate(self.weights):
            outputs = []
            for row in range(weights.shape[0]):
                factors, bias = row_parameters(layer, row)
                total = mi.Float(bias)
                for factor, value in zip(factors, x, strict=True):
                    total = dr.fma(factor, value, total)
                outputs.append(self._activate(total) if layer < len(self.weights) - 1 else total)
            x = outputs
        return x

    def _apply_cooperative_vectors(self, x: list[Float]) -> list[Float]:
        """Apply the network to its inputs by cooperative vectors: such a kernel compiles at once."""
        for layer, (weights, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer:
                x = [self._activate(value) for value in x]
            x = list(nn.matvec(nn.view(weights), nn.CoopVec(*x), nn.view(bias)))
        return x


def expm1(x: Color) -> Color:
    """Return exp(x) - 1 without cancellation at the small values that dark materials have."""
    return dr.select(dr.abs(x) < 0.01, x * (1 + x * (0.5 + x / 6)), dr.exp(x) - 1)


def half_difference(light: Vector3, viewer: Vector3) -> tuple[Vector3, Vector3]:
    """Return the half vector, turned to phi_h = 0, and the difference vector of directions above the surface.

    See :func:`metapp.appearance.geometry.half_difference_vectors`.
    """
    sine, cosine, _, _, difference = half_frame(light, viewer)
    return mi.Vector3f(sine, 0, cosine), difference


def half_frame(light: Vector3, viewer: Vector3) -> tuple[Float, Float, Float, Float, Vector3]:
    """Return sine and cosine of theta_h, cosine and sine of phi_h, and the difference vector of directions.

    Both directions are above the surface. phi_h is 0 if the half vector is the normal.
    """
    direction_sum = light + viewer
    length = dr.norm(direction_sum)
    half = direction_sum / length
    square = half.x * half.x + half.y * half.y
    azimuthal = square > 0  # where the half vector is the normal any azimuth will do: 0
    sine = dr.sqrt(dr.select(azimuthal, square, 1))
    cos_phi, sin_phi = dr.select(azimuthal, half.x / sine, 1), dr.select(azimuthal, half.y / sine, 0)
    sine = dr.select(azimuthal, sine, 0)
    x, y = cos_phi * light.x + sin_phi * light.y, cos_phi * light.y - sin_phi * light.x
    # z is length / 2, not half . light, which is off by the rounding of lengths where directions are nearly opposite
    difference = mi.Vector3f(half.z * x - sine * light.z, y, length / 2)
    return sine, half.z, cos_phi, sin_phi, difference


def isotropic_features(half: Vector3, difference: Vector3) -> list[Float]:
    """Return the inputs of an isotropic feature network.

    See :func:`metapp.apps.brdf.feature_network.isotropic_inputs`, which computes them in torch.

    Args:
        half: half vector, turned to phi_h = 0.
        difference: difference vector.
    """
    angle = dr.atan2(half.x, half.z)
    square = angle * angle
    x_squared, y_squared = dr.square(difference.x), dr.square(difference.y)
    sum_of_squares, smooth_difference = (
        x_squared + y_squared,
        square / (square + AZIMUTH_ONSET_RAD2) * (x_squared - y_squared),
    )
    along, across = (
        dr.sqrt((sum_of_squares + smooth_difference) / 2 + VECTOR_SMOOTHING),
        dr.sqrt((sum_of_squares - smooth_difference) / 2 + VECTOR_SMOOTHING),
    )
    mean_cosine, half_cosine_range = half.z * difference.z, dr.sqrt(dr.square(half.x * difference.x) + COSINE_SMOOTHING)
    lower, higher = mean_cosine - half_cosine_range, mean_cosine + half_cosine_range
    logs = (square + 1e-4, square + 1e-2, dr.maximum(lower, 1e-3), dr.maximum(higher, 1e-3))
    plain = [
        *half,
        along,
        across,
        difference.z,
        lower,
        higher,
        dr.sqrt(angle),
        1 / (1 + 100 * square),
        smooth_difference,
    ]
    return [*plain, *(0.4 * dr.log(value) + 1 for value in logs)]


def anisotropic_features(light: Vector3, viewer: Vector3) -> list[Float]:
    """Return the inputs of an anisotropic feature network for directions in the material's axes.

    See :func:`metapp.apps.brdf.anisotropic.anisotropic_inputs`, which computes them in torch.
    """
    sine, cosine, cos_phi, sin_phi, difference = half_frame(light, viewer)
    x, y, z = difference.x, difference.y, difference.z
    angle = dr.atan2(sine, cosine)
    along, across = angle * cos_phi, angle * sin_phi
    squares = [dr.square(angle), dr.square(along), dr.square(across)]
    diagonals = [dr.square(along + across) / 2, dr.square(along - across) / 2]
    tangent_x, tangent_y = cos_phi * cosine * x - sin_phi * y, sin_phi * cosine * x + cos_phi * y
    cosine_product = dr.maximum(light.z * viewer.z, 1e-6)
    logs = [square + floor for square in squares for floor in (1e-4, 1e-2)]
    logs += [*(square + 1e-3 for square in diagonals), cosine_product]
    plain = [sine * cos_phi, sine * sin_phi, cosine, z, x * x - y * y, x * y, z * z, cosine_product]
    plain += [
        dr.square(light.z - viewer.z),
        dr.sqrt(angle),
        *(1 / (1 + 100 * value) for value in (*squares, *diagonals)),
    ]
    plain += [tangent_x * tangent_x - tangent_y * tangent_y, tangent_x * tangent_y]
    plain += [(squares[1] - squares[2]) / (squares[0] + 1e-3), along * across / (squares[0] + 1e-3)]
    return [*plain, *(0.4 * dr.log(value) + 1 for value in logs)]


def read_parameters(path: Path) -> Params:
    """Read the parameters of a BRDF's network, without a task axis.

    Args:
        path: the .safetensors file of a fit, or an NBRDF folder.

    Raises:
        ValueError: no such file or folder, or it is damaged.
    """
    if not path.is_file():
        arrays = {name: torch.from_numpy(array) for name, array in read_nbrdf(path).items()}
        weights = {f"w{layer}": arrays[f"fc{layer}"].T for layer in (1, 2, 3)}
        return weights | {f"b{layer}": arrays[f"b{layer}"][:, None] for layer in (1, 2, 3)}
    try:
        theta = read_tensors(path)
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: not readable ({error}), expected the .safetensors file of a BRDF fit.") from None
    shapes = {key: value.shape for key, value in theta.items()}
    recipes = [entry.load() for entry in registry().applications["brdf"].recipes.values()]
    apps: list[Any] = [recipe.app_with(rule) for recipe in recipes for rule in recipe.meta]
    if shapes not in [parameter_shapes(network) for network in {app.network for app in apps}]:
        names = ", ".join(sorted(theta)) or "none"
        raise ValueError(f"{path}: tensors {names[:80]}, expected those of a BRDF fit; take its params.safetensors.")
    if not all(bool(value.isfinite().all()) for value in theta.values()):
        raise ValueError(f"{path}: NaN or infinite values, expected finite parameters; fit again.")
    return theta


def register_neural_brdf() -> None:
    """Register the plugin `neural_brdf` with Mitsuba."""
    register_plugin("bsdf", "neural_brdf", neural_brdf_class)


def neural_brdf_class() -> mt.PluginClass:
    """Make the class of the plugin in Mitsuba's active variant."""

    class NeuralBrdf(make_bsdf_class(NetworkReflection)):  # type: ignore[misc]
        """The plugin, with the properties `filename` and `tint`, a texture that multiplies reflectance (1 if none)."""

    return NeuralBrdf


class NetworkReflection(Reflection):
    """A reflection by a fitted network times a tint.

    Its parameters are the network's `weights0`, `bias0`, ..., which are differentiable, and the parameters of the tint.
    Directions are sampled from lobes that fit the network as it was loaded: later changes of weights change the noise
    of pictures alone.

    Args:
        props: Mitsuba's properties of the plugin: `filename`, and `tint`, a texture.

    Attributes:
        path: the file or folder of the fit.
        network: the network.
        mixture: the lobes.
        tint: the texture that multiplies reflectance.
    """

    def __init__(self, props: mt.Properties) -> None:
        self.path = Path(str(mi.file_resolver().resolve(props["filename"])))
        theta = read_parameters(self.path)
        network = find_network(theta)
        folded = network.fold(theta)
        self.network = MitsubaNetwork(folded)
        self.mixture = MitsubaLobeMixture(
            fit_lobes(functools.partial(network.evaluate, theta), folded.axes_azimuth_rad)
        )
        self.tint = props.get_texture("tint", 1.0)
        self.components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]

    @override
    def reflect_at(
        self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask
    ) -> LocalReflection:
        def value(light: mt.Vector3) -> mt.Color:
            pair = (light, viewer) if ctx.mode == mi.TransportMode.Radiance else (viewer, light)
            return self.network.reflectance(*pair) * (self.tint.eval(si, active) * light.z)

        return LocalReflection(
            value,
            lambda light: self.mixture.density(viewer, light),
            lambda number, point: (self.mixture.sample(viewer, number, point), mi.UInt32(0)),
        )

    @override
    def traverse(self, callback: mt.TraversalCallback) -> None:
        for i, (weights, bias) in enumerate(zip(self.network.weights, self.network.biases, strict=True)):
            callback.put(f"weights{i}", weights, mi.ParamFlags.Differentiable)
            callback.put(f"bias{i}", bias, mi.ParamFlags.Differentiable)
        callback.put("tint", self.tint, mi.ParamFlags.Differentiable)

    @override
    def update_parameters(self) -> None:
        self.network.read_weights_from_memory()

    @override
    def __str__(self) -> str:
        sizes = "-".join(str(weights.shape[1]) for weights in self.network.weights)
        return f'NeuralBrdf[filename = "{self.path}", layers = {sizes}-3, tint = {self.tint}]'

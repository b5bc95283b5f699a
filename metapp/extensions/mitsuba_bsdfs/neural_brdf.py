"""The BSDF `neural_brdf` of Mitsuba 3: a fitted network, sampled by lobes that were fitted to it.

The network runs in Dr.Jit, in whatever variant is active, and is differentiable in its weights and in the directions.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import torch
from safetensors import SafetensorError

from data_tools.readers.nbrdf_files import read_nbrdf
from metapp.appearance.lobes import fit_lobes
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf.brdf_network import PlainLayers, find_network, parameter_shapes
from metapp.apps.brdf.feature_network import AZIMUTH_ONSET_RAD2, COSINE_SMOOTHING, VECTOR_SMOOTHING
from metapp.extensions.mitsuba_bsdfs.mixture import MitsubaLobeMixture, turn_about_normal
from metapp.extensions.mitsuba_bsdfs.python_bsdf import LocalReflection, Reflection, make_bsdf_class
from metapp.learning.task import Params
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, nn, register_plugin
from metapp.rendering.types import Color, Float, Vector3
from metapp.storage.files import read_tensors

MAX_LOG_REFLECTANCE = 14.0  # logarithm that such a network may end at


class MitsubaNetwork:
    """A fit's network in the active variant.

    Attributes:
        weights, biases: TensorXf [out, in] and Float [out] of each layer; who changes them says so by `changed`.
        featured: whether hidden layers are x sigmoid(x); else ReLU.
        turn, darkest: `axes_azimuth_rad` and `log_floor` of `metapp.apps.brdf.brdf_network.PlainLayers`.
    """

    def __init__(self, folded: PlainLayers) -> None:
        layers = [(weights.float().numpy(), bias.float().numpy()) for weights, bias in folded.layers]
        self.weights = [mi.TensorXf(weights) for weights, _ in layers]
        self.biases = [mi.Float(bias) for _, bias in layers]
        self.featured, self.turn, self.darkest = folded.inputs != "nbrdf", folded.axes_azimuth_rad, folded.log_floor
        self._constants = [(weights.tolist(), bias.tolist()) for weights, bias in layers]
        self._zero = dr.opaque(mi.UInt32, 0)

    def changed(self) -> None:
        """Read the weights from memory from now on, several times slower than constants of the kernel."""
        self._constants = []

    def reflectance(self, light: Vector3, viewer: Vector3) -> Color:
        """Linear RGB in 1/sr, >= 0 (Color3f), of directions above the surface in its local frame (Vector3f)."""
        if self.turn is not None:
            inputs = anisotropic_features(*(turn_about_normal(each, -self.turn) for each in (light, viewer)))
        else:
            half, difference = half_difference(light, viewer)
            inputs = isotropic_features(half, difference) if self.featured else [*half, *difference]
        if self._constants and not dr.grad_enabled(self.weights, self.biases):
            # a call, though it always goes the same way: evaluated twice in a kernel, a network is compiled once
            last = dr.switch(self._zero, [self._by_constants, lambda *_: [mi.Float(0)] * 3], *inputs)
        elif mi.variant().startswith("llvm"):
            last = self._by_vectors(inputs)
        else:  # OptiX has cooperative vectors of half precision alone
            last = self._by_gathers(inputs)
        if not self.darkest:
            return dr.maximum(expm1(mi.Color3f(last)), 0)
        product = dr.maximum(light.z * viewer.z, self.darkest)
        return dr.maximum((dr.exp(dr.minimum(mi.Color3f(last), MAX_LOG_REFLECTANCE)) - self.darkest) / product, 0)

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
    """Half vector, turned to phi_h = 0, and difference vector of `metapp.appearance.geometry.half_difference_vectors`."""
    sine, cosine, _, _, difference = half_frame(light, viewer)
    return mi.Vector3f(sine, 0, cosine), difference


def half_frame(light: Vector3, viewer: Vector3) -> tuple[Float, Float, Float, Float, Vector3]:
    """Sine and cosine of theta_h, cosine and sine of phi_h, difference vector of directions above the surface.

    phi_h is 0 if the half vector is the normal.
    """
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
    return sine, half.z, cos_phi, sin_phi, difference


def isotropic_features(half: Vector3, difference: Vector3) -> list[Float]:
    """`metapp.apps.brdf.feature_network.isotropic_inputs` of half vector, phi_h 0, and difference vector."""
    angle = dr.atan2(half.x, half.z)
    square = angle * angle
    first, second = dr.square(difference.x), dr.square(difference.y)
    both, apart = first + second, square / (square + AZIMUTH_ONSET_RAD2) * (first - second)
    along, across = dr.sqrt((both + apart) / 2 + VECTOR_SMOOTHING), dr.sqrt((both - apart) / 2 + VECTOR_SMOOTHING)
    common, differ = half.z * difference.z, dr.sqrt(dr.square(half.x * difference.x) + COSINE_SMOOTHING)
    lower, higher = common - differ, common + differ
    logs = (square + 1e-4, square + 1e-2, dr.maximum(lower, 1e-3), dr.maximum(higher, 1e-3))
    plain = [*half, along, across, difference.z, lower, higher, dr.sqrt(angle), 1 / (1 + 100 * square), apart]
    return [*plain, *(0.4 * dr.log(value) + 1 for value in logs)]


def anisotropic_features(light: Vector3, viewer: Vector3) -> list[Float]:
    """`metapp.apps.brdf.anisotropic.anisotropic_inputs` of directions in the material's axes."""
    sine, cosine, cos_phi, sin_phi, difference = half_frame(light, viewer)
    x, y, z = difference.x, difference.y, difference.z
    angle = dr.atan2(sine, cosine)
    along, across = angle * cos_phi, angle * sin_phi
    squares = [dr.square(angle), dr.square(along), dr.square(across)]
    diagonals = [dr.square(along + across) / 2, dr.square(along - across) / 2]
    first, second = cos_phi * cosine * x - sin_phi * y, sin_phi * cosine * x + cos_phi * y
    both = dr.maximum(light.z * viewer.z, 1e-6)
    logs = [square + floor for square in squares for floor in (1e-4, 1e-2)]
    logs += [*(square + 1e-3 for square in diagonals), both]
    more = [sine * cos_phi, sine * sin_phi, cosine, z, x * x - y * y, x * y, z * z, both]
    more += [dr.square(light.z - viewer.z), dr.sqrt(angle), *(1 / (1 + 100 * each) for each in (*squares, *diagonals))]
    more += [first * first - second * second, first * second]
    more += [(squares[1] - squares[2]) / (squares[0] + 1e-3), along * across / (squares[0] + 1e-3)]
    return [*more, *(0.4 * dr.log(value) + 1 for value in logs)]


def read_parameters(path: Path) -> Params:
    """The parameters of a BRDF's network, without a task axis: of a fit's .safetensors file, or of an NBRDF folder.

    Raises:
        ValueError: there is none, or it is damaged.
    """
    if not path.is_file():
        parts = {part: torch.from_numpy(array) for part, array in read_nbrdf(path).items()}
        weights = {f"w{layer}": parts[f"fc{layer}"].T for layer in (1, 2, 3)}
        return weights | {f"b{layer}": parts[f"b{layer}"][:, None] for layer in (1, 2, 3)}
    try:
        theta = read_tensors(path)
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: not readable ({error}), expected the .safetensors file of a BRDF fit.") from None
    shapes = {key: value.shape for key, value in theta.items()}
    recipes = recipes_of("brdf").values()
    networks = {app_of("brdf", recipe, rule=rule).network for recipe in recipes for rule in recipe.meta}
    if shapes not in [parameter_shapes(network) for network in networks]:
        names = ", ".join(sorted(theta)) or "none"
        raise ValueError(f"{path}: tensors {names[:80]}, expected those of a BRDF fit; take its params.safetensors.")
    if not all(bool(value.isfinite().all()) for value in theta.values()):
        raise ValueError(f"{path}: NaN or infinite values, expected finite parameters; fit again.")
    return theta


def register_neural_brdf() -> None:
    """Have Mitsuba know the plugin."""
    register_plugin("bsdf", "neural_brdf", neural_brdf_class)


def neural_brdf_class() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class NeuralBrdf(make_bsdf_class(NetworkReflection)):  # type: ignore[misc]
        """Properties: `filename`, and a texture `tint` that multiplies (1 without)."""

    return NeuralBrdf


class NetworkReflection(Reflection):
    """A fitted network times a tint.

    Parameters: `weights0`, `bias0`, ... of the network, differentiable, and the tint's. Directions are sampled from
    lobes of the network as it was loaded, whatever becomes of its weights: that changes the noise alone.
    """

    def __init__(self, props: mt.Properties) -> None:
        self.path = Path(str(mi.file_resolver().resolve(props["filename"])))
        theta = read_parameters(self.path)
        fit = find_network(theta)
        folded = fit.fold(theta)
        self.network = MitsubaNetwork(folded)
        self.mixture = MitsubaLobeMixture(fit_lobes(functools.partial(fit.evaluate, theta), folded.axes_azimuth_rad))
        self.tint = props.get_texture("tint", 1.0)
        self.components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]

    def at(self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask) -> LocalReflection:
        """The network for a viewer, sampled by the mixture."""

        def value(light: mt.Vector3) -> mt.Color:
            pair = (light, viewer) if ctx.mode == mi.TransportMode.Radiance else (viewer, light)
            return self.network.reflectance(*pair) * (self.tint.eval(si, active) * light.z)

        return LocalReflection(
            value,
            lambda light: self.mixture.density(viewer, light),
            lambda number, point: (self.mixture.sample(viewer, number, point), mi.UInt32(0)),
        )

    def traverse(self, callback: mt.TraversalCallback) -> None:
        """Name the network's and the tint's."""
        for i, (weights, bias) in enumerate(zip(self.network.weights, self.network.biases, strict=True)):
            callback.put(f"weights{i}", weights, mi.ParamFlags.Differentiable)
            callback.put(f"bias{i}", bias, mi.ParamFlags.Differentiable)
        callback.put("tint", self.tint, mi.ParamFlags.Differentiable)

    def changed(self) -> None:
        """Weights are no constants any more."""
        self.network.changed()

    def __str__(self) -> str:
        sizes = "-".join(str(weights.shape[1]) for weights in self.network.weights)
        return f'NeuralBrdf[filename = "{self.path}", layers = {sizes}-3, tint = {self.tint}]'

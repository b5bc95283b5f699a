"""The BSDF `neural_brdf` of Mitsuba 3: a fitted network, sampled by lobes that were fitted to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from metapp.rendering import types as mt
from metapp.rendering.brdf_lobes import LAST, NODES, Lobes, fit_lobes
from metapp.rendering.brdf_network import Material, Network
from metapp.rendering.jit import dr, mi
from metapp.rendering.plugins import LocalReflection, Reflection, reflection_bsdf, register_plugin

NAME = "neural_brdf"

Read = Callable[[Path], Material]


def register_neural_brdf(read: Read) -> None:
    """Have Mitsuba know the plugin.

    Args:
        read: a file or folder to its material; ValueError where it is none.
    """
    register_plugin("bsdf", NAME, lambda: plugin(read))


def plugin(read: Read) -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class NeuralBrdf(reflection_bsdf(lambda props: NetworkReflection(props, read))):  # type: ignore[misc]
        """Properties: `filename`, and a texture `tint` that multiplies (1 without)."""

    return NeuralBrdf


class NetworkReflection(Reflection):
    """A fitted network times a tint.

    Parameters: `weights0`, `bias0`, ... of the network, differentiable, and the tint's. Directions are sampled from
    lobes of the network as it was loaded, whatever becomes of its weights: that changes the noise alone.
    """

    def __init__(self, props: mt.Properties, read: Read) -> None:
        self.path = Path(str(mi.file_resolver().resolve(props["filename"])))
        material = read(self.path)
        self.network, self.mixture = Network(material), Mixture(fit_lobes(material.reflectance))
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


class Mixture:
    """Lobes in the active variant."""

    def __init__(self, lobes: Lobes) -> None:
        self.alphas = lobes.alphas
        self.shares = [mi.Float(column) for column in lobes.shares.astype(np.float32).T]

    def shares_of(self, viewer: mt.Vector3) -> list[mt.Float]:
        """The share of each lobe, the cosine first, for a viewer's direction; between nodes linearly."""
        place = dr.minimum(dr.safe_acos(viewer.z) * ((NODES - 1) / LAST), NODES - 1)
        node = mi.UInt32(dr.minimum(place, NODES - 2))
        first, second = ([dr.gather(mi.Float, share, node + i) for share in self.shares] for i in (0, 1))
        return [dr.lerp(a, b, place - node) for a, b in zip(first, second, strict=True)]

    def sample(self, viewer: mt.Vector3, number: mt.Float, point: mt.Point2) -> mt.Vector3:
        """A direction, which may be below the surface, of a number and a point in [0, 1)."""
        shares = self.shares_of(viewer)
        alpha, end = mi.Float(self.alphas[0]), shares[0] + shares[1]
        for share, other in zip(shares[2:], self.alphas[1:], strict=True):
            alpha = dr.select(number < end, alpha, other)
            end += share
        half, _ = _facets(alpha).sample(viewer, point)
        # Mitsuba draws NaN once in a million times, at facets that stand upright; below the surface it counts nothing
        mirrored = dr.select(half.z >= 0, mi.reflect(viewer, half), mi.Vector3f(0, 0, -1))
        return dr.select(number < shares[0], mi.warp.square_to_cosine_hemisphere(point), mirrored)

    def density(self, viewer: mt.Vector3, light: mt.Vector3) -> mt.Float:
        """Density of `sample` for directions above the surface, per solid angle."""
        shares = self.shares_of(viewer)
        half = dr.normalize(viewer + light)
        total = shares[0] * light.z * dr.inv_pi
        for share, alpha in zip(shares[1:], self.alphas, strict=True):
            total += share * _facets(alpha).pdf(viewer, half) / (4 * dr.dot(light, half))
        return total


def _facets(alpha: mt.Float) -> mt.Facets:
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)

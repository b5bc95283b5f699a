"""The BSDF `neural_brdf` of Mitsuba 3: a fitted network, sampled by lobes that were fitted to it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from metapp.rendering.brdf_lobes import LAST, NODES, Lobes, fit_lobes
from metapp.rendering.brdf_network import Material, Network, dr, mi
from metapp.rendering.plugins import register_plugin

NAME = "neural_brdf"

Read = Callable[[Path], Material]


def register_neural_brdf(read: Read) -> None:
    """Have Mitsuba know the plugin.

    Args:
        read: a file or folder to its material; ValueError where it is none.
    """
    register_plugin("bsdf", NAME, lambda: plugin(read))


class Mixture:
    """Lobes in the active variant: draws directions and says how densely."""

    def __init__(self, lobes: Lobes) -> None:
        self.alphas = lobes.alphas
        self.shares = [mi.Float(column) for column in lobes.shares.astype(np.float32).T]

    def shares_of(self, viewer: Any) -> list[Any]:
        """The share of each lobe, the cosine first, for a viewer's direction; between nodes linearly."""
        at = dr.minimum(dr.safe_acos(viewer.z) * ((NODES - 1) / LAST), NODES - 1)
        node = mi.UInt32(dr.minimum(at, NODES - 2))
        first, second = ([dr.gather(mi.Float, each, node + i) for each in self.shares] for i in (0, 1))
        return [dr.lerp(a, b, at - node) for a, b in zip(first, second, strict=True)]

    def sample(self, viewer: Any, which: Any, point: Any) -> Any:
        """Draw a direction, which may be below the surface, by a number and a point in [0, 1)."""
        shares = self.shares_of(viewer)
        alpha, at = mi.Float(self.alphas[0]), shares[0] + shares[1]
        for share, other in zip(shares[2:], self.alphas[1:], strict=True):
            alpha = dr.select(which < at, alpha, other)
            at += share
        half, _ = _facets(alpha).sample(viewer, point)
        # Mitsuba draws NaN once in a million times, at facets that stand upright; below the surface it counts nothing
        mirrored = dr.select(half.z >= 0, mi.reflect(viewer, half), mi.Vector3f(0, 0, -1))
        return dr.select(which < shares[0], mi.warp.square_to_cosine_hemisphere(point), mirrored)

    def density(self, viewer: Any, light: Any) -> Any:
        """Density of `sample` for directions above the surface, per solid angle."""
        shares = self.shares_of(viewer)
        half = dr.normalize(viewer + light)
        total = shares[0] * light.z * dr.inv_pi
        for share, alpha in zip(shares[1:], self.alphas, strict=True):
            total += share * _facets(alpha).pdf(viewer, half) / (4 * dr.dot(light, half))
        return total


def _facets(alpha: Any) -> Any:
    return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)


def plugin(read: Read) -> Any:
    """The class of the plugin in the active variant."""

    class NeuralBrdf(mi.BSDF):  # type: ignore[misc]  # a class of the variant
        """Properties: `filename`, and a texture `tint` that multiplies (1 without).

        Parameters: `weights0`, `bias0`, ... of the network, differentiable, and the tint's. Directions are drawn from
        lobes of the network as it was loaded, whatever becomes of its weights: that changes the noise alone.
        """

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.path = Path(str(mi.file_resolver().resolve(props["filename"])))
            material = read(self.path)
            self.network, self.mixture = Network(material), Mixture(fit_lobes(material.reflectance))
            self.tint = props.get_texture("tint", 1.0)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            active = self._seen(ctx, si, wo, active)
            return dr.select(active, self.mixture.density(si.wi, wo), 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            active = self._seen(ctx, si, wo, active)
            # directions below the surface are not what a network was fitted to: the values may be anything
            pair = [dr.select(active, each, mi.Vector3f(0, 0, 1)) for each in (wo, si.wi)]
            value = self.network.reflectance(*(pair if ctx.mode == mi.TransportMode.Radiance else reversed(pair)))
            value *= self.tint.eval(si, active) * wo.z
            return dr.select(active, value, 0), dr.select(active, self.mixture.density(si.wi, wo), 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            drawn = dr.zeros(mi.BSDFSample3f)
            drawn.wo = self.mixture.sample(si.wi, sample1, sample2)
            value, drawn.pdf = self.eval_pdf(ctx, si, drawn.wo, active)
            drawn.eta = 1.0
            drawn.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            drawn.sampled_component = mi.UInt32(0)
            return drawn, dr.select(drawn.pdf > 0, value / drawn.pdf, 0)

        def _seen(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
            wanted = ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0)
            return mi.Bool(active) & mi.Bool(wanted) & (si.wi.z > 0) & (wo.z > 0)

        def traverse(self, callback: Any) -> None:
            for i, (weights, bias) in enumerate(zip(self.network.weights, self.network.biases, strict=True)):
                callback.put(f"weights{i}", weights, mi.ParamFlags.Differentiable)
                callback.put(f"bias{i}", bias, mi.ParamFlags.Differentiable)
            callback.put("tint", self.tint, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: Any) -> None:
            self.network.changed()

        def to_string(self) -> str:
            sizes = "-".join(str(weights.shape[1]) for weights in self.network.weights)
            return f'NeuralBrdf[filename = "{self.path}", layers = {sizes}-3, tint = {self.tint}]'

    return NeuralBrdf

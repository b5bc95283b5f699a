"""The BSDF `neural_svbrdf` of Mitsuba 3: maps of a fitted material, shaded as `metapp.appearance.flash.brdf` does.

    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}

The specular texture is F0, in colour, which Mitsuba's `principled` takes as one number only. Normals go around it, as
Mitsuba's own `normalmap`. Choose a libLLVM before this module is imported: `metapp.rendering.variant.choose_llvm`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from metapp.appearance.flash import SMOOTHEST
from metapp.rendering.plugins import register_plugin

NAME = "neural_svbrdf"
DEFAULTS = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5}
BODY, LOBE = 0, 1  # components
LEAST = 0.1  # share of directions that are drawn for either


def register_maps_bsdf() -> None:
    """Have Mitsuba know the plugin."""
    register_plugin("bsdf", NAME, plugin)


class Texel:
    """A material in one place of the active variant, seen from one direction."""

    def __init__(self, diffuse: Any, specular: Any, roughness: Any, viewer: Any) -> None:
        alpha = dr.square(dr.maximum(roughness, SMOOTHEST))
        self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self.diffuse, self.specular, self.viewer = diffuse, specular, viewer
        lobe, body = dr.mean(self._fresnel(viewer.z)), dr.mean(diffuse * (1 - specular))
        self.share = dr.clip(lobe / dr.maximum(lobe + body, 1e-6), LEAST, 1 - LEAST)

    def _fresnel(self, cosine: Any) -> Any:
        return self.specular + (1 - self.specular) * dr.power(dr.maximum(1 - cosine, 0), 5)

    def body(self, light: Any) -> Any:
        """The Lambertian part, times the light's cosine."""
        return self.diffuse * (1 - self.specular) * (dr.inv_pi * light.z)

    def lobe(self, light: Any) -> Any:
        """The microfacets' part, times the light's cosine."""
        half = dr.normalize(self.viewer + light)
        shape = self.facets.eval(half) * self.facets.G(self.viewer, light, half) / (4 * self.viewer.z)
        return self._fresnel(dr.dot(light, half)) * shape

    def density(self, light: Any, share: Any) -> Any:
        """Of directions of which such a share is drawn for the lobe, per solid angle."""
        half = dr.normalize(self.viewer + light)
        lobe = self.facets.pdf(self.viewer, half) / (4 * dr.dot(light, half))
        return dr.lerp(light.z * dr.inv_pi, lobe, share)

    def drawn(self, which: Any, point: Any, share: Any) -> Any:
        """A direction, which may be below the surface, by a number and a point in [0, 1)."""
        half, _ = self.facets.sample(self.viewer, point)
        mirrored = mi.reflect(self.viewer, half)
        return dr.select(which < share, mirrored, mi.warp.square_to_cosine_hemisphere(point))


def plugin() -> Any:
    """The class of the plugin in the active variant."""

    class NeuralSvbrdf(mi.BSDF):  # a class of the variant
        """Properties: the textures `diffuse`, `specular` (F0, linear RGB) and `roughness` (GGX alpha is its square)."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.textures = {key: props.get_texture(key, value) for key, value in DEFAULTS.items()}
            varying = mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying
            self.m_components = [mi.BSDFFlags.DiffuseReflection | varying, mi.BSDFFlags.GlossyReflection | varying]
            self.m_flags = self.m_components[BODY] | self.m_components[LOBE]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            body, lobe = self._wanted(ctx)
            active = mi.Bool(active) & mi.Bool(body or lobe) & (si.wi.z > 0) & (wo.z > 0)
            # below the surface, where the values are left out, they should still be finite
            light, viewer = (dr.select(active, each, mi.Vector3f(0, 0, 1)) for each in (wo, si.wi))
            texel = self._texel(si, viewer, active)
            value = (texel.body(light) if body else 0) + (texel.lobe(light) if lobe else 0)
            density = texel.density(light, self._share(texel, body, lobe))
            return dr.select(active, mi.Color3f(value), 0), dr.select(active, density, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            body, lobe = self._wanted(ctx)
            active = mi.Bool(active) & mi.Bool(body or lobe) & (si.wi.z > 0)
            viewer = dr.select(active, si.wi, mi.Vector3f(0, 0, 1))
            texel = self._texel(si, viewer, active)
            share = self._share(texel, body, lobe)
            drawn: Any = dr.zeros(mi.BSDFSample3f)
            drawn.wo = texel.drawn(sample1, sample2, share)
            value, drawn.pdf = self.eval_pdf(ctx, si, drawn.wo, active)
            is_lobe = sample1 < share
            kinds = (mi.BSDFFlags.GlossyReflection, mi.BSDFFlags.DiffuseReflection)
            drawn.eta = 1.0
            drawn.sampled_type = dr.select(is_lobe, *(mi.UInt32(+kind) for kind in kinds))
            drawn.sampled_component = dr.select(is_lobe, mi.UInt32(LOBE), mi.UInt32(BODY))
            return drawn, dr.select(drawn.pdf > 0, value / drawn.pdf, 0)

        def eval_diffuse_reflectance(self, si: Any, active: Any = True) -> Any:
            return self.textures["diffuse"].eval(si, active)

        def _texel(self, si: Any, viewer: Any, active: Any) -> Texel:
            diffuse, specular = (self.textures[key].eval(si, active) for key in ("diffuse", "specular"))
            return Texel(diffuse, specular, self.textures["roughness"].eval_1(si, active), viewer)

        def _wanted(self, ctx: Any) -> tuple[bool, bool]:
            kinds = ((mi.BSDFFlags.DiffuseReflection, BODY), (mi.BSDFFlags.GlossyReflection, LOBE))
            body, lobe = (bool(ctx.is_enabled(kind, component)) for kind, component in kinds)
            return body, lobe

        def _share(self, texel: Texel, body: bool, lobe: bool) -> Any:
            return texel.share if body and lobe else mi.Float(1.0 if lobe else 0.0)

        def traverse(self, callback: Any) -> None:
            for key, texture in self.textures.items():
                callback.put(key, texture, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"NeuralSvbrdf[{', '.join(f'{key} = {texture}' for key, texture in self.textures.items())}]"

    return NeuralSvbrdf

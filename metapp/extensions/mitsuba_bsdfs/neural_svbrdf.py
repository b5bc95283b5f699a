"""The BSDF `neural_svbrdf` of Mitsuba 3: the maps of a fitted material.

    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}

It is shaded as `metapp.appearance.flash.evaluate_brdf` does. The specular texture is F0, in colour, which Mitsuba's `principled`
takes as one number only. Normals go around it, as Mitsuba's own `normalmap`.
"""

from __future__ import annotations

from metapp.appearance.flash import LEAST_ROUGHNESS
from metapp.extensions.mitsuba_bsdfs.python_bsdf import LocalReflection, Reflection, enabled_components, make_bsdf_class
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin

DEFAULT_TEXTURE_VALUES = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5}
DIFFUSE_COMPONENT, SPECULAR_COMPONENT = 0, 1  # components
MIN_COMPONENT_SHARE = 0.1  # share of directions that are sampled for either


def register_neural_svbrdf() -> None:
    """Have Mitsuba know the plugin."""
    register_plugin("bsdf", "neural_svbrdf", neural_svbrdf_class)


def neural_svbrdf_class() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class NeuralSvbrdf(make_bsdf_class(MapsReflection)):  # type: ignore[misc]
        """Properties: the textures `diffuse`, `specular` (F0, linear RGB) and `roughness` (GGX alpha is its square)."""

        def eval_diffuse_reflectance(self, si: mt.Interaction, active: mt.Mask = True) -> mt.Color:
            return self.reflection.textures["diffuse"].eval(si, active)

    return NeuralSvbrdf


class MapsReflection(Reflection):
    """A Lambertian and a GGX component, with textures for their parameters."""

    def __init__(self, props: mt.Properties) -> None:
        self.textures = {key: props.get_texture(key, value) for key, value in DEFAULT_TEXTURE_VALUES.items()}
        kinds = (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)
        self.components = [kind | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying for kind in kinds]

    def at(self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask) -> LocalReflection:
        """The texels at points of surfaces."""
        diffuse, specular = (self.textures[key].eval(si, active) for key in ("diffuse", "specular"))
        roughness = self.textures["roughness"].eval_1(si, active)
        texel = Texel((diffuse, specular, roughness), viewer, enabled_components(ctx, self.components))
        return LocalReflection(texel.value, texel.density, texel.sample)

    def traverse(self, callback: mt.TraversalCallback) -> None:
        """Name the textures."""
        for key, texture in self.textures.items():
            callback.put(key, texture, mi.ParamFlags.Differentiable)

    def __str__(self) -> str:
        return f"NeuralSvbrdf[{', '.join(f'{key} = {texture}' for key, texture in self.textures.items())}]"


class Texel:
    """A material at points of surfaces, for one viewer of each."""

    def __init__(self, maps: tuple[mt.Color, mt.Color, mt.Float], viewer: mt.Vector3, wanted: list[bool]) -> None:
        diffuse, specular, roughness = maps
        alpha = dr.square(dr.maximum(roughness, LEAST_ROUGHNESS))
        self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self.diffuse, self.specular, self.viewer, self.wanted = diffuse, specular, viewer, wanted
        glossy, matte = dr.mean(self._fresnel(viewer.z)), dr.mean(diffuse * (1 - specular))
        both = dr.clip(glossy / dr.maximum(glossy + matte, 1e-6), MIN_COMPONENT_SHARE, 1 - MIN_COMPONENT_SHARE)
        self.share = (
            both if all(wanted) else mi.Float(1.0 if wanted[SPECULAR_COMPONENT] else 0.0)
        )  # of specular directions

    def value(self, light: mt.Vector3) -> mt.Color:
        """The BSDF times the light's cosine."""
        half = dr.normalize(self.viewer + light)
        shape = self.facets.eval(half) * self.facets.G(self.viewer, light, half) / (4 * self.viewer.z)
        specular = self._fresnel(dr.dot(light, half)) * shape
        diffuse = self.diffuse * (1 - self.specular) * (dr.inv_pi * light.z)
        return mi.Color3f(
            (diffuse if self.wanted[DIFFUSE_COMPONENT] else 0) + (specular if self.wanted[SPECULAR_COMPONENT] else 0)
        )

    def density(self, light: mt.Vector3) -> mt.Float:
        """Of `sample`, per solid angle."""
        half = dr.normalize(self.viewer + light)
        specular = self.facets.pdf(self.viewer, half) / (4 * dr.dot(light, half))
        return dr.lerp(light.z * dr.inv_pi, specular, self.share)

    def sample(self, number: mt.Float, point: mt.Point2) -> tuple[mt.Vector3, mt.UInt32]:
        """A direction, which may be below the surface, and its component, of a number and a point in [0, 1)."""
        half, _ = self.facets.sample(self.viewer, point)
        is_specular = number < self.share
        cosine = mi.warp.square_to_cosine_hemisphere(point)
        wo = dr.select(is_specular, mi.reflect(self.viewer, half), cosine)
        return wo, dr.select(is_specular, mi.UInt32(SPECULAR_COMPONENT), mi.UInt32(DIFFUSE_COMPONENT))

    def _fresnel(self, cosine: mt.Float) -> mt.Color:
        """Of Schlick."""
        return self.specular + (1 - self.specular) * dr.power(dr.maximum(1 - cosine, 0), 5)

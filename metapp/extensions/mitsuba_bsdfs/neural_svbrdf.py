"""The BSDF `neural_svbrdf` of Mitsuba 3: the maps of a fitted material.

    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}

It shades as `metapp.appearance.flash.evaluate_brdf` does. The specular texture is F0 in colour, which Mitsuba's
`principled` takes as one number only. A map of normals is not among its textures: wrap it into Mitsuba's `normalmap`.
"""

from __future__ import annotations

from typing_extensions import override

from metapp.appearance.flash import LEAST_ROUGHNESS
from metapp.extensions.mitsuba_bsdfs.python_bsdf import LocalReflection, Reflection, enabled_components, make_bsdf_class
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin

DEFAULT_TEXTURE_VALUES = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5}
DIFFUSE_COMPONENT, SPECULAR_COMPONENT = 0, 1  # indices of the components of the BSDF
MIN_COMPONENT_SHARE = 0.1  # share of directions that are sampled for each component at least


def register_neural_svbrdf() -> None:
    """Register the plugin `neural_svbrdf` with Mitsuba."""
    register_plugin("bsdf", "neural_svbrdf", neural_svbrdf_class)


def neural_svbrdf_class() -> mt.PluginClass:
    """Make the class of the plugin in Mitsuba's active variant."""

    class NeuralSvbrdf(make_bsdf_class(MapsReflection)):  # type: ignore[misc]
        """The plugin, with the textures `diffuse`, `specular` (F0, linear RGB) and `roughness`, the root of alpha."""

        def eval_diffuse_reflectance(self, si: mt.Interaction, active: mt.Mask = True) -> mt.Color:
            return self.reflection.textures["diffuse"].eval(si, active)

    return NeuralSvbrdf


class MapsReflection(Reflection):
    """A reflection with a Lambertian and a GGX component, whose parameters are textures.

    Args:
        props: Mitsuba's properties of the plugin, with the textures that DEFAULT_TEXTURE_VALUES names.

    Attributes:
        textures: the textures by name.
    """

    def __init__(self, props: mt.Properties) -> None:
        self.textures = {key: props.get_texture(key, value) for key, value in DEFAULT_TEXTURE_VALUES.items()}
        kinds = (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)
        self.components = [kind | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying for kind in kinds]

    @override
    def reflect_at(
        self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask
    ) -> LocalReflection:
        diffuse, specular = (self.textures[key].eval(si, active) for key in ("diffuse", "specular"))
        roughness = self.textures["roughness"].eval_1(si, active)
        texel = Texel((diffuse, specular, roughness), viewer, enabled_components(ctx, self.components))
        return LocalReflection(texel.value, texel.density, texel.sample)

    @override
    def traverse(self, callback: mt.TraversalCallback) -> None:
        for key, texture in self.textures.items():
            callback.put(key, texture, mi.ParamFlags.Differentiable)

    @override
    def __str__(self) -> str:
        return f"NeuralSvbrdf[{', '.join(f'{key} = {texture}' for key, texture in self.textures.items())}]"


class Texel:
    """The material at points of surfaces, seen by one viewer at each point.

    Args:
        maps: values of the textures: diffuse colour, F0 and roughness.
        viewer: directions of the viewers, above the surface.
        enabled: whether the diffuse and the specular component are evaluated.

    Attributes:
        facets: Mitsuba's GGX distribution of the texels' roughness.
        specular_share: the share of directions that are sampled for the specular component, in [0, 1].
    """

    def __init__(self, maps: tuple[mt.Color, mt.Color, mt.Float], viewer: mt.Vector3, enabled: list[bool]) -> None:
        diffuse, specular, roughness = maps
        alpha = dr.square(dr.maximum(roughness, LEAST_ROUGHNESS))
        self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self.diffuse, self.specular, self.viewer, self.enabled = diffuse, specular, viewer, enabled
        glossy, matte = dr.mean(self._fresnel_reflectance(viewer.z)), dr.mean(diffuse * (1 - specular))
        glossy_share = dr.clip(glossy / dr.maximum(glossy + matte, 1e-6), MIN_COMPONENT_SHARE, 1 - MIN_COMPONENT_SHARE)
        # of directions that are sampled for the specular component
        self.specular_share = glossy_share if all(enabled) else mi.Float(1.0 if enabled[SPECULAR_COMPONENT] else 0.0)

    def value(self, light: mt.Vector3) -> mt.Color:
        """Return the BSDF times the cosine of the light."""
        half = dr.normalize(self.viewer + light)
        facets = self.facets.eval(half) * self.facets.G(self.viewer, light, half) / (4 * self.viewer.z)
        specular = self._fresnel_reflectance(dr.dot(light, half)) * facets
        diffuse = self.diffuse * (1 - self.specular) * (dr.inv_pi * light.z)
        return mi.Color3f(
            (diffuse if self.enabled[DIFFUSE_COMPONENT] else 0) + (specular if self.enabled[SPECULAR_COMPONENT] else 0)
        )

    def density(self, light: mt.Vector3) -> mt.Float:
        """Return the density per solid angle with which :meth:`sample` draws a light's direction."""
        half = dr.normalize(self.viewer + light)
        specular = self.facets.pdf(self.viewer, half) / (4 * dr.dot(light, half))
        return dr.lerp(light.z * dr.inv_pi, specular, self.specular_share)

    def sample(self, number: mt.Float, point: mt.Point2) -> tuple[mt.Vector3, mt.UInt32]:
        """Sample a direction of the light, which may be below the surface, and the index of its component.

        Args:
            number: a random number in [0, 1), which chooses the component.
            point: a random point in [0, 1)^2, which chooses the direction.
        """
        half, _ = self.facets.sample(self.viewer, point)
        is_specular = number < self.specular_share
        cosine = mi.warp.square_to_cosine_hemisphere(point)
        wo = dr.select(is_specular, mi.reflect(self.viewer, half), cosine)
        return wo, dr.select(is_specular, mi.UInt32(SPECULAR_COMPONENT), mi.UInt32(DIFFUSE_COMPONENT))

    def _fresnel_reflectance(self, cosine: mt.Float) -> mt.Color:
        """Return Schlick's approximation of the Fresnel reflectance for a cosine of light and half vector."""
        return self.specular + (1 - self.specular) * dr.power(dr.maximum(1 - cosine, 0), 5)

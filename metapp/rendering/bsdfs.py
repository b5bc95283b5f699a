"""BSDFs of Mitsuba 3 that are written in Python, and one of them: `neural_svbrdf`, the maps of a fitted material.

    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}

It is shaded as `metapp.appearance.flash.brdf` does. The specular texture is F0, in colour, which Mitsuba's `principled`
takes as one number only. Normals go around it, as Mitsuba's own `normalmap`.
"""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

from metapp.appearance.flash import SMOOTHEST
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin

NAME = "neural_svbrdf"
DEFAULTS = {"diffuse": 0.5, "specular": 0.04, "roughness": 0.5}
DIFFUSE, SPECULAR = 0, 1  # components
LEAST = 0.1  # share of directions that are sampled for either


class LocalReflection(NamedTuple):
    """A reflection at points of surfaces, for a viewer above each; lights are unit vectors above the surface.

    Attributes:
        value: of lights, the BSDF times their cosine.
        density: of lights, that of `sample`, per solid angle.
        sample: a direction, which may be below the surface, and its component, of a number and a point in [0, 1).
    """

    value: Callable[[mt.Vector3], mt.Color]
    density: Callable[[mt.Vector3], mt.Float]
    sample: Callable[[mt.Float, mt.Point2], tuple[mt.Vector3, mt.UInt32]]


class Reflection(ABC):
    """A reflection on the upper side of surfaces.

    Attributes:
        components: the flags of each, one of them GlossyReflection or DiffuseReflection.
    """

    components: Sequence[mt.BsdfFlags]

    @abstractmethod
    def at(self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask) -> LocalReflection:
        """What it is at points of surfaces, of the components that a context asks for."""

    @abstractmethod
    def traverse(self, callback: mt.TraversalCallback) -> None:
        """Name the parameters, as Mitsuba's objects do."""

    def changed(self) -> None:  # noqa: B027  (nothing to do for most)
        """Called after parameters were changed."""


def enabled(ctx: mt.BsdfContext, components: Sequence[mt.BsdfFlags]) -> list[bool]:
    """Which components a context asks for."""
    return [bool(ctx.is_enabled(mi.BSDFFlags(_kind(flags)), i)) for i, flags in enumerate(components)]


def _kind(flags: mt.BsdfFlags) -> int:
    return int(flags) & int(mi.BSDFFlags.All)


def reflection_bsdf(make: Callable[[mt.Properties], Reflection]) -> mt.PluginClass:
    """A BSDF in the active variant, to derive plugins from.

    Args:
        make: the reflection by the plugin's properties.
    """

    class ReflectionBsdf(mi.BSDF):  # type: ignore[misc]  # a class of the variant
        def __init__(self, props: mt.Properties) -> None:
            mi.BSDF.__init__(self, props)
            self.reflection = make(props)
            self.m_components = self.reflection.components
            self.m_flags = functools.reduce(operator.or_, self.m_components)

        def eval(self, ctx: mt.BsdfContext, si: mt.Interaction, wo: mt.Vector3, active: mt.Mask = True) -> mt.Color:
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx: mt.BsdfContext, si: mt.Interaction, wo: mt.Vector3, active: mt.Mask = True) -> mt.Float:
            local, light, active = self._local(ctx, si, wo, active)
            return dr.select(active, local.density(light), 0)

        def eval_pdf(
            self, ctx: mt.BsdfContext, si: mt.Interaction, wo: mt.Vector3, active: mt.Mask = True
        ) -> tuple[mt.Color, mt.Float]:
            local, light, active = self._local(ctx, si, wo, active)
            return dr.select(active, local.value(light), 0), dr.select(active, local.density(light), 0)

        def sample(
            self, ctx: mt.BsdfContext, si: mt.Interaction, sample1: mt.Float, sample2: mt.Point2, active: mt.Mask = True
        ) -> tuple[mt.BsdfSample, mt.Color]:
            local, _, active = self._local(ctx, si, si.wi, active)
            drawn = dr.zeros(mi.BSDFSample3f)
            drawn.wo, drawn.sampled_component = local.sample(sample1, sample2)
            value, drawn.pdf = self.eval_pdf(ctx, si, drawn.wo, active)
            drawn.eta = 1.0
            for i, flags in enumerate(self.m_components):
                kind = mi.UInt32(_kind(flags))
                drawn.sampled_type = dr.select(drawn.sampled_component == i, kind, drawn.sampled_type)
            return drawn, dr.select(drawn.pdf > 0, value / drawn.pdf, 0)

        def _local(
            self, ctx: mt.BsdfContext, si: mt.Interaction, wo: mt.Vector3, active: mt.Mask
        ) -> tuple[LocalReflection, mt.Vector3, mt.Mask]:
            """The reflection, the light's direction, and where both directions are above the surface."""
            active = mi.Bool(active) & mi.Bool(any(enabled(ctx, self.m_components))) & (si.wi.z > 0) & (wo.z > 0)
            # below the surface, where values are left out, they should still be finite
            light, viewer = (dr.select(active, direction, mi.Vector3f(0, 0, 1)) for direction in (wo, si.wi))
            return self.reflection.at(ctx, si, viewer, active), light, active

        def traverse(self, callback: mt.TraversalCallback) -> None:
            self.reflection.traverse(callback)

        def parameters_changed(self, keys: list[str]) -> None:
            self.reflection.changed()

        def to_string(self) -> str:
            return str(self.reflection)

    return ReflectionBsdf


def register_maps_bsdf() -> None:
    """Have Mitsuba know the plugin."""
    register_plugin("bsdf", NAME, plugin)


def plugin() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class NeuralSvbrdf(reflection_bsdf(MapsReflection)):  # type: ignore[misc]
        """Properties: the textures `diffuse`, `specular` (F0, linear RGB) and `roughness` (GGX alpha is its square)."""

        def eval_diffuse_reflectance(self, si: mt.Interaction, active: mt.Mask = True) -> mt.Color:
            return self.reflection.textures["diffuse"].eval(si, active)

    return NeuralSvbrdf


class MapsReflection(Reflection):
    """A Lambertian and a GGX component, with textures for their parameters."""

    def __init__(self, props: mt.Properties) -> None:
        self.textures = {key: props.get_texture(key, value) for key, value in DEFAULTS.items()}
        kinds = (mi.BSDFFlags.DiffuseReflection, mi.BSDFFlags.GlossyReflection)
        self.components = [kind | mi.BSDFFlags.FrontSide | mi.BSDFFlags.SpatiallyVarying for kind in kinds]

    def at(self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask) -> LocalReflection:
        """The texels at points of surfaces."""
        diffuse, specular = (self.textures[key].eval(si, active) for key in ("diffuse", "specular"))
        roughness = self.textures["roughness"].eval_1(si, active)
        texel = Texel((diffuse, specular, roughness), viewer, enabled(ctx, self.components))
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
        alpha = dr.square(dr.maximum(roughness, SMOOTHEST))
        self.facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, True)
        self.diffuse, self.specular, self.viewer, self.wanted = diffuse, specular, viewer, wanted
        glossy, matte = dr.mean(self._fresnel(viewer.z)), dr.mean(diffuse * (1 - specular))
        both = dr.clip(glossy / dr.maximum(glossy + matte, 1e-6), LEAST, 1 - LEAST)
        self.share = both if all(wanted) else mi.Float(1.0 if wanted[SPECULAR] else 0.0)  # of specular directions

    def value(self, light: mt.Vector3) -> mt.Color:
        """The BSDF times the light's cosine."""
        half = dr.normalize(self.viewer + light)
        shape = self.facets.eval(half) * self.facets.G(self.viewer, light, half) / (4 * self.viewer.z)
        specular = self._fresnel(dr.dot(light, half)) * shape
        diffuse = self.diffuse * (1 - self.specular) * (dr.inv_pi * light.z)
        return mi.Color3f((diffuse if self.wanted[DIFFUSE] else 0) + (specular if self.wanted[SPECULAR] else 0))

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
        return wo, dr.select(is_specular, mi.UInt32(SPECULAR), mi.UInt32(DIFFUSE))

    def _fresnel(self, cosine: mt.Float) -> mt.Color:
        """Of Schlick."""
        return self.specular + (1 - self.specular) * dr.power(dr.maximum(1 - cosine, 0), 5)

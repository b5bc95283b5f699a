"""The base of BSDFs of Mitsuba 3 that are written in Python: reflection on the upper side of surfaces.

A :class:`Reflection` knows directions above the surface alone. Here it becomes a class of Mitsuba's active variant,
with masks, components and flags as Mitsuba's integrators expect them. Networks and maps are not known here.
"""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi


class LocalReflection(NamedTuple):
    """A reflection at points of surfaces for a viewer above each of them.

    Attributes:
        value: a function of lights, unit vectors above the surface: the BSDF times the light's cosine.
        density: a function of lights, unit vectors above the surface: the density per solid angle of `sample`.
        sample: a function of a random number and a random point in [0, 1): a direction of the light, which may be below
            the surface, and the index of its component.
    """

    value: Callable[[mt.Vector3], mt.Color]
    density: Callable[[mt.Vector3], mt.Float]
    sample: Callable[[mt.Float, mt.Point2], tuple[mt.Vector3, mt.UInt32]]


class Reflection(ABC):
    """A reflection on the upper side of surfaces.

    Attributes:
        components: the flags of each component, among them GlossyReflection or DiffuseReflection.
    """

    components: Sequence[mt.BsdfFlags]

    @abstractmethod
    def reflect_at(
        self, ctx: mt.BsdfContext, si: mt.Interaction, viewer: mt.Vector3, active: mt.Mask
    ) -> LocalReflection:
        """Return the reflection at points of surfaces, of the components that a context asks for.

        Args:
            ctx: Mitsuba's context of the query: components, and whether radiance or importance is transported.
            si: the points.
            viewer: unit vectors to the viewer, above the surface, in the local frames of the points.
            active: the points that count.
        """

    @abstractmethod
    def traverse(self, callback: mt.TraversalCallback) -> None:
        """Pass each parameter and its name to a callback, as objects of Mitsuba do."""

    def update_parameters(self) -> None:  # noqa: B027  (nothing to do for most)
        """Take in parameters that a user has changed."""


def enabled_components(ctx: mt.BsdfContext, components: Sequence[mt.BsdfFlags]) -> list[bool]:
    """Return for each component whether a context asks for it."""
    return [bool(ctx.is_enabled(mi.BSDFFlags(_type_bits(flags)), i)) for i, flags in enumerate(components)]


def _type_bits(flags: mt.BsdfFlags) -> int:
    """Return the flags that say which type a component is of, without others such as its side."""
    return int(flags) & int(mi.BSDFFlags.All)


def make_bsdf_class(make: Callable[[mt.Properties], Reflection]) -> mt.PluginClass:
    """Make a class of BSDFs in Mitsuba's active variant, to derive plugins from.

    Args:
        make: makes the reflection from the properties of a plugin.
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
            bsdf_sample = dr.zeros(mi.BSDFSample3f)
            bsdf_sample.wo, bsdf_sample.sampled_component = local.sample(sample1, sample2)
            value, bsdf_sample.pdf = self.eval_pdf(ctx, si, bsdf_sample.wo, active)
            bsdf_sample.eta = 1.0
            for i, flags in enumerate(self.m_components):
                sampled_type = mi.UInt32(_type_bits(flags))
                bsdf_sample.sampled_type = dr.select(
                    bsdf_sample.sampled_component == i, sampled_type, bsdf_sample.sampled_type
                )
            return bsdf_sample, dr.select(bsdf_sample.pdf > 0, value / bsdf_sample.pdf, 0)

        def _local(
            self, ctx: mt.BsdfContext, si: mt.Interaction, wo: mt.Vector3, active: mt.Mask
        ) -> tuple[LocalReflection, mt.Vector3, mt.Mask]:
            """Return the reflection, the direction of the light, and where light and viewer are above the surface."""
            active = (
                mi.Bool(active) & mi.Bool(any(enabled_components(ctx, self.m_components))) & (si.wi.z > 0) & (wo.z > 0)
            )
            # values below the surface are masked out later, but they should be finite for derivatives
            light, viewer = (dr.select(active, direction, mi.Vector3f(0, 0, 1)) for direction in (wo, si.wi))
            return self.reflection.reflect_at(ctx, si, viewer, active), light, active

        def traverse(self, callback: mt.TraversalCallback) -> None:
            self.reflection.traverse(callback)

        def parameters_changed(self, keys: list[str]) -> None:
            self.reflection.update_parameters()

        def to_string(self) -> str:
            return str(self.reflection)

    return ReflectionBsdf

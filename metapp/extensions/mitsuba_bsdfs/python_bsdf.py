"""The base of BSDFs of Mitsuba 3 that are written in Python: reflection on the upper side of surfaces."""

from __future__ import annotations

import functools
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi


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
        """The reflection at points of surfaces, of the components that a context asks for."""

    @abstractmethod
    def traverse(self, callback: mt.TraversalCallback) -> None:
        """Name the parameters, as Mitsuba's objects do."""

    def changed(self) -> None:  # noqa: B027  (nothing to do for most)
        """Called after parameters were changed."""


def enabled_components(ctx: mt.BsdfContext, components: Sequence[mt.BsdfFlags]) -> list[bool]:
    """Which components a context asks for."""
    return [bool(ctx.is_enabled(mi.BSDFFlags(_kind(flags)), i)) for i, flags in enumerate(components)]


def _kind(flags: mt.BsdfFlags) -> int:
    return int(flags) & int(mi.BSDFFlags.All)


def make_bsdf_class(make: Callable[[mt.Properties], Reflection]) -> mt.PluginClass:
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
            active = (
                mi.Bool(active) & mi.Bool(any(enabled_components(ctx, self.m_components))) & (si.wi.z > 0) & (wo.z > 0)
            )
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

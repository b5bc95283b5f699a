"""Plugins for Mitsuba 3 that are written in Python, registered in every variant, and what their BSDFs share."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import NoReturn, Protocol

from metapp.rendering.jit import dr, mi
from metapp.rendering.types import (
    BsdfContext,
    BsdfFlags,
    BsdfSample,
    Color,
    Float,
    Interaction,
    Mask,
    PluginClass,
    Point2,
    Properties,
    TraversalCallback,
    UInt32,
    Vector3,
)

VARIANTS = ("llvm_ad_rgb", "cuda_ad_rgb")


def register_plugin(kind: str, name: str, make: Callable[[], PluginClass]) -> None:
    """Have Mitsuba know a plugin, in the variant that is active and in all that will be.

    In variants other than VARIANTS a scene that names it is refused.

    Args:
        kind: of plugin, as Mitsuba's functions name it: bsdf, integrator, ...
        name: of the plugin in scenes.
        make: returns its class in the active variant.
    """

    def refuse(props: Properties) -> NoReturn:
        raise ValueError(
            f"{name}: variant {mi.variant()}, expected {' or '.join(VARIANTS)}; mi.set_variant('llvm_ad_rgb')."
        )

    def register(*_: object) -> None:
        # the function is another one in each variant
        getattr(mi, f"register_{kind}")(name, make() if mi.variant() in VARIANTS else refuse)

    mi.detail.add_variant_callback(register)
    if mi.variant():
        register()


class LocalReflection(Protocol):
    """A reflection at points of surfaces, for a viewer above each; lights are unit vectors above the surface."""

    def value(self, light: Vector3) -> Color:
        """The BSDF times the light's cosine."""

    def density(self, light: Vector3) -> Float:
        """By which `sample` draws a direction, per solid angle."""

    def sample(self, number: Float, point: Point2) -> tuple[Vector3, UInt32]:
        """A direction, which may be below the surface, and its component, of a number and a point in [0, 1)."""


class Reflection(Protocol):
    """A reflection on the upper side of surfaces.

    Attributes:
        components: the flags of each, one of them GlossyReflection or DiffuseReflection.
    """

    components: list[BsdfFlags]

    def at(self, ctx: BsdfContext, si: Interaction, viewer: Vector3, active: Mask) -> LocalReflection:
        """What it is at points of surfaces."""

    def traverse(self, callback: TraversalCallback) -> None:
        """As of Mitsuba's objects."""

    def changed(self) -> None:
        """Called after parameters were changed."""


def enabled(ctx: BsdfContext, components: list[BsdfFlags]) -> list[bool]:
    """Which components a context asks for."""
    return [bool(ctx.is_enabled(mi.BSDFFlags(_kind(flags)), i)) for i, flags in enumerate(components)]


def _kind(flags: BsdfFlags) -> int:
    return int(flags) & int(mi.BSDFFlags.All)


def reflection_bsdf(make: Callable[[Properties], Reflection]) -> PluginClass:
    """A BSDF in the active variant, to derive plugins from.

    Args:
        make: the reflection by the plugin's properties.
    """

    class ReflectionBsdf(mi.BSDF):  # type: ignore[misc]  # a class of the variant
        def __init__(self, props: Properties) -> None:
            mi.BSDF.__init__(self, props)
            self.reflection = make(props)
            self.m_components = self.reflection.components
            self.m_flags = functools.reduce(operator.or_, self.m_components)

        def eval(self, ctx: BsdfContext, si: Interaction, wo: Vector3, active: Mask = True) -> Color:
            local, light, active = self._local(ctx, si, wo, active)
            return dr.select(active, local.value(light), 0)

        def pdf(self, ctx: BsdfContext, si: Interaction, wo: Vector3, active: Mask = True) -> Float:
            local, light, active = self._local(ctx, si, wo, active)
            return dr.select(active, local.density(light), 0)

        def eval_pdf(self, ctx: BsdfContext, si: Interaction, wo: Vector3, active: Mask = True) -> tuple[Color, Float]:
            local, light, active = self._local(ctx, si, wo, active)
            return dr.select(active, local.value(light), 0), dr.select(active, local.density(light), 0)

        def sample(
            self, ctx: BsdfContext, si: Interaction, sample1: Float, sample2: Point2, active: Mask = True
        ) -> tuple[BsdfSample, Color]:
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
            self, ctx: BsdfContext, si: Interaction, wo: Vector3, active: Mask
        ) -> tuple[LocalReflection, Vector3, Mask]:
            """The reflection, the light's direction, and where both directions are above the surface."""
            active = mi.Bool(active) & mi.Bool(any(enabled(ctx, self.m_components))) & (si.wi.z > 0) & (wo.z > 0)
            # below the surface, where values are left out, they should still be finite
            light, viewer = (dr.select(active, direction, mi.Vector3f(0, 0, 1)) for direction in (wo, si.wi))
            return self.reflection.at(ctx, si, viewer, active), light, active

        def traverse(self, callback: TraversalCallback) -> None:
            self.reflection.traverse(callback)

        def parameters_changed(self, keys: list[str]) -> None:
            self.reflection.changed()

        def to_string(self) -> str:
            return str(self.reflection)

    return ReflectionBsdf

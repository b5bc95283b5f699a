"""Paths by their random numbers, for :mod:`metapp.rendering.paths.path_space`, with or without next-event estimation.

With it, the mean over all numbers that a point does not hold is the mean of paths without it, where these meet the
light at all: a direction that the point holds decides alone which light the path meets, and emitters are sampled from
the next surface on. There multiple importance sampling counts light from both sides once (Veach & Guibas 1995).
Emitters that no direction meets (point, spot, directional) are sampled at all surfaces but the first. Their light on
the first surface depends on no direction: it is no part of a path's radiance, but comes beside it, for pictures.
"""

from __future__ import annotations

from dataclasses import dataclass

from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi


def mis_weight(density: mt.Float, other: mt.Float) -> mt.Float:
    """Return the weight of a sample by the power heuristic (Veach & Guibas 1995).

    Args:
        density: density by which the sample was drawn.
        other: density by which the other technique would draw it.
    """
    square = dr.square(density)
    weight = square / (square + dr.square(other))
    return dr.select(dr.isfinite(weight), weight, 0)


@dataclass
class _Paths:
    """The state of all paths in the loop, each before its next surface.

    Attributes:
        rng: random streams, one a path.
        ray: the ray to the next surface.
        depth: edges so far.
        scattering_count: number of surfaces so far that scatter.
        radiance: radiance so far, linear RGB.
        direct: light on the first surface that scatters, of emitters that no direction meets.
        throughput: share of the next surface's light that reaches the film, linear RGB.
        origin: the surface that the ray leaves, by a direction of `density` per solid angle.
        density: density of the ray's direction.
        is_emitter_weighted: whether emitters were sampled at `origin`, too, so that light which the ray meets counts by
            a weight.
        active: whether the path goes on.
    """

    rng: mt.RandomStreams
    ray: mt.Ray
    depth: mt.UInt32
    scattering_count: mt.UInt32
    radiance: mt.Color
    direct: mt.Color
    throughput: mt.Color
    origin: mt.Interaction
    density: mt.Float
    is_emitter_weighted: mt.Mask
    active: mt.Mask


def trace_paths(
    scene: mt.Scene,
    ray: mt.Ray,
    directions: list[mt.Point2],
    rng: mt.RandomStreams,
    depth: int,
    next_event: bool,
) -> tuple[mt.Color, mt.Color]:
    """Trace paths through a scene by given numbers for their first directions, and random ones for all others.

    Args:
        scene: Mitsuba's object.
        ray: the first ray of each path.
        directions: numbers for the direction at each of the first surfaces that scatter; the first surface has no
            next-event estimation of lights that a direction can meet, even if there are none.
        rng: draws all further numbers.
        depth: edges of the longest path.
        next_event: whether emitters are sampled, too; else a path counts only by the lights that it meets.

    Returns:
        The radiance of paths; and beside it the light of point, spot and directional emitters at the first surface that
        scatters, 0 without next-event estimation.
    """
    first_sampled = max(len(directions), 1)

    def bounce(paths: _Paths) -> tuple[_Paths]:
        si = scene.ray_intersect(paths.ray, paths.active)
        paths.radiance += paths.throughput * _weighted_emission(scene, si, paths, next_event)
        paths.depth += 1
        active = paths.active & si.is_valid() & (paths.depth < depth)
        bsdf, rng, context = si.bsdf(paths.ray), paths.rng, mi.BSDFContext()
        scatters = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        if next_event:
            emitter_numbers = mi.Point2f(rng.next_float32(), rng.next_float32())
            emitter, emitted = scene.sample_emitter_direction(si, emitter_numbers, True, scatters)
        lobe_number, direction_numbers = rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
        for number, direction in enumerate(directions):
            direction_numbers = dr.select(paths.scattering_count == number, direction, direction_numbers)
        if next_event:
            to_emitter = si.to_local(emitter.d)
            value, density, sample, weight = bsdf.eval_pdf_sample(
                context, si, to_emitter, lobe_number, direction_numbers, active
            )
            emitter_weight = dr.select(emitter.delta, 1, mis_weight(emitter.pdf, density))
            is_lit = scatters & (emitter.pdf != 0) & (emitter.delta | (paths.scattering_count >= first_sampled))
            light = dr.select(is_lit, paths.throughput * value * emitted * emitter_weight, 0)
            paths.direct += dr.select(paths.scattering_count == 0, light, 0)
            paths.radiance += dr.select(paths.scattering_count == 0, 0, light)
            paths.is_emitter_weighted = (
                scatters
                & (paths.scattering_count >= first_sampled)
                & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            )
            paths.origin, paths.density = si, sample.pdf
        else:
            sample, weight = bsdf.sample(context, si, lobe_number, direction_numbers, active)
        paths.scattering_count += dr.select(scatters, mi.UInt32(1), mi.UInt32(0))
        paths.throughput *= weight
        paths.active = active & (dr.max(paths.throughput) > 0)
        paths.ray = si.spawn_ray(si.to_world(sample.wo))
        return (paths,)

    count = dr.width(ray)
    paths = _Paths(
        rng, ray, mi.UInt32(0), mi.UInt32(0), mi.Color3f(0), mi.Color3f(0), mi.Color3f(1),
        dr.zeros(mi.SurfaceInteraction3f), mi.Float(1), mi.Bool(False), dr.full(mi.Bool, True, count),
    )  # fmt: skip
    (paths,) = dr.while_loop((paths,), lambda paths: paths.active, bounce)
    return paths.radiance, paths.direct


def _weighted_emission(scene: mt.Scene, si: mt.Interaction, paths: _Paths, next_event: bool) -> mt.Color:
    """Return the emission of the surface or sky that paths met, by its MIS weight if emitters were sampled before."""
    light = si.emitter(scene, paths.active).eval(si, paths.active)
    if not next_event:
        return light
    direction_sample = mi.DirectionSample3f(scene, si=si, ref=paths.origin)
    density = scene.pdf_emitter_direction(paths.origin, direction_sample, paths.active & paths.is_emitter_weighted)
    return light * dr.select(paths.is_emitter_weighted, mis_weight(paths.density, density), 1)

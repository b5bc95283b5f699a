"""A path tracer whose directions a cache of the scene's light draws, at every surface that scatters.

It is Mitsuba's `path`, with the same multiple importance sampling of emitters, but for how directions are drawn: from
the cache where a surface is diffuse alone, from cache or material at random where it is glossy, too (one-sample
multiple importance sampling), by the material where it is smooth or see-through. The mean is that of `path` whatever
the cache holds.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from metapp.rendering.guide_cache import CELLS, GuideCache

RECORDED = 8  # bounces of a path that are learned from
MIXED, GLOSSY = 0.5, 0.25  # share of directions that the cache draws where surfaces are diffuse and more, or glossy


class Settings(NamedTuple):
    """As of Mitsuba's `path`.

    Attributes:
        max_depth: edges of the longest path.
        rr_depth: edges from which on paths end by chance.
        joins: whether surfaces are joined to emitters as well (next-event estimation).
    """

    max_depth: int
    rr_depth: int
    joins: bool = True


class Bounce(NamedTuple):
    """What is noted of a bounce.

    Attributes:
        index: place * CELLS + cell.
        density: of the direction that was drawn, over the cosine's.
        weight: luminance of the path's weight before it.
        light: luminance that the path had, with what joined it here; `shone`, without.
        point, normal: of the surface.
    """

    index: Any
    density: Any
    weight: Any
    light: Any
    shone: Any
    point: Any
    normal: Any


class Records:
    """What the first RECORDED bounces of so many paths chose, to be judged when their ends are known."""

    def __init__(self, mi: Any, paths: int) -> None:
        import drjit

        self.mi, self.dr, self.paths = mi, drjit, paths
        self.lane = drjit.arange(mi.UInt32, paths)
        self.cells = drjit.zeros(mi.UInt32, paths * RECORDED)  # place * CELLS + cell + 1
        self.numbers = [drjit.zeros(mi.Float, paths * RECORDED) for _ in range(3)]  # density, weight, light so far
        drjit.eval(self.lane, self.cells, self.numbers)

    def put(self, depth: Any, bounce: Bounce, active: Any) -> None:
        """Note a bounce."""
        at, active = self.lane * RECORDED + depth, active & (depth < RECORDED)
        values = (bounce.index + 1, bounce.density, bounce.weight, bounce.light)
        for store, value in zip((self.cells, *self.numbers), values, strict=True):
            self.dr.scatter(store, value, at, active)

    def teach(self, cache: GuideCache, radiance: Any) -> None:
        """Add all bounces to a cache, by what the paths carried in the end."""
        mi, dr = self.mi, self.dr
        total = mi.luminance(radiance)
        dr.eval(total, self.cells, self.numbers)
        density, weight, before = self.numbers
        after = dr.gather(mi.Float, total, dr.arange(mi.UInt32, self.paths * RECORDED) // RECORDED) - before
        carried = dr.maximum(after, 0) / dr.maximum(weight, 1e-12)
        active = (self.cells > 0) & (density > 0) & dr.isfinite(carried)
        cache.add(self.cells - 1, density, carried, active)
        dr.eval(cache.sums, cache.met)


class PathTracer:
    """Traces paths.

    Args:
        mi: Mitsuba, in a variant of Dr.Jit.
        settings: of the paths.
    """

    def __init__(self, mi: Any, settings: Settings) -> None:
        import drjit

        self.mi, self.dr, self.settings = mi, drjit, settings

    def trace(
        self, scene: Any, sampler: Any, ray: Any, cache: GuideCache, guided: bool, records: Records | None
    ) -> tuple[Any, Any]:
        """Follow rays.

        Args:
            scene, sampler, ray: as of `sample` of an integrator.
            cache: of the scene.
            guided: draw directions from it.
            records: where to note what was chosen, of as many paths as there are rays.

        Returns:
            radiance, and where a ray met something, a sky at least.
        """
        mi, dr = self.mi, self.dr

        def bounce(sampler: Any, ray: Any, depth: Any, light: Any, weight: Any, eta: Any, before: Any, density: Any,
                   is_delta: Any, met: Any, active: Any) -> tuple[Any, ...]:  # fmt: skip
            at = scene.ray_intersect(ray, mi.RayFlags.All, depth == 0, active)
            light += weight * self._emitted(scene, at, before, density, is_delta, active)
            onwards = active & (depth + 1 < self.settings.max_depth) & at.is_valid()
            turn = Turn(self, scene, sampler, at, at.bsdf(ray), onwards)
            chosen = turn.by_cache(cache) if guided else turn.by_material()
            shone = mi.luminance(light)
            light += weight * chosen.joined
            if records is not None:
                turn.note(cache, records, chosen, depth, (mi.luminance(weight), mi.luminance(light), shone))
            weight *= chosen.weight
            eta *= chosen.eta
            met |= onwards & ~chosen.is_null
            brightest = dr.max(weight)
            onwards &= brightest != 0
            lasting = dr.minimum(brightest * dr.square(eta), 0.95)
            by_chance = depth >= self.settings.rr_depth
            weight = dr.select(by_chance, weight / lasting, weight)
            onwards &= ~by_chance | (sampler.next_1d(by_chance) < lasting)
            ray = mi.RayDifferential3f(at.spawn_ray(at.to_world(chosen.wo)))
            return (sampler, ray, depth + 1, light, weight, eta, at, chosen.density, chosen.is_delta, met, onwards)

        nowhere, sky = dr.zeros(mi.SurfaceInteraction3f), mi.Bool(scene.environment() is not None)
        state = (sampler, mi.RayDifferential3f(ray), mi.UInt32(0), mi.Color3f(0), mi.Color3f(1), mi.Float(1),
                 nowhere, mi.Float(1), mi.Bool(True), sky, mi.Bool(True))  # fmt: skip
        done = dr.while_loop(state, lambda *state: state[-1], bounce)
        return done[3], done[9]

    def _emitted(self, scene: Any, at: Any, before: Any, density: Any, is_delta: Any, active: Any) -> Any:
        """What the surface or sky that was met sends out, by its share beside that of joining."""
        found = self.mi.DirectionSample3f(scene, si=at, ref=before)
        light = found.emitter.eval(at, active)
        if not self.settings.joins:
            return light
        return light * self.share(density, scene.pdf_emitter_direction(before, found, active & ~is_delta))

    def share(self, density: Any, other: Any) -> Any:
        """The power heuristic (Veach & Guibas 1995)."""
        dr = self.dr
        square = dr.square(density)
        share = square / (square + dr.square(other))
        return dr.select(dr.isfinite(share), share, 0)


class Chosen(NamedTuple):
    """How a path goes on.

    Attributes:
        wo: the direction, in the surface's frame.
        density: of it, per solid angle.
        weight: the material's value over that, times the cosine.
        eta: ratio of refraction.
        is_delta: whether it had no choice; is_null, whether it went straight on.
        joined: light that came by joining the surface to an emitter.
        noted: density over the cosine's, place and cell in the cache; None where the cache was not asked.
    """

    wo: Any
    density: Any
    weight: Any
    eta: Any
    is_delta: Any
    is_null: Any
    joined: Any
    noted: tuple[Any, Any, Any] | None


class Turn:
    """One bounce of paths at surfaces."""

    def __init__(self, tracer: PathTracer, scene: Any, sampler: Any, at: Any, bsdf: Any, active: Any) -> None:
        mi, dr = tracer.mi, tracer.dr
        self.mi, self.dr, self.tracer, self.at, self.bsdf, self.active = mi, dr, tracer, at, bsdf, active
        flags, kinds = bsdf.flags(), mi.BSDFFlags
        self.scatters = active & mi.has_flag(flags, kinds.Smooth)
        self.joins = tracer.settings.joins
        if self.joins:
            aim, self.emitted = scene.sample_emitter_direction(at, sampler.next_2d(), True, self.scatters)
            self.aim, self.is_joined = aim, self.scatters & (aim.pdf != 0)
        self.draws = sampler.next_1d(), sampler.next_2d()
        # how much of the directions the cache draws
        diffuse, glossy = (mi.has_flag(flags, kind) for kind in (kinds.DiffuseReflection, kinds.GlossyReflection))
        through = mi.has_flag(flags, kinds.Transmission)
        others = int(kinds.All) & ~int(kinds.DiffuseReflection)
        alone = diffuse & (flags & mi.UInt32(others) == 0)
        some = dr.select(diffuse, MIXED, dr.select(glossy & ~through, GLOSSY, 0))
        self.share = dr.select(alone, 1, some)

    def by_material(self) -> Chosen:
        """Draw directions as the material does."""
        mi, context = self.mi, self.mi.BSDFContext()
        if self.joins:
            wo = self.at.to_local(self.aim.d)
            value, density, drawn, weight = self.bsdf.eval_pdf_sample(context, self.at, wo, *self.draws, self.active)
            joined = self._joined(value, density)
        else:
            drawn, weight = self.bsdf.sample(context, self.at, *self.draws, self.active)
            joined = mi.Color3f(0)
        is_delta, is_null = (mi.has_flag(drawn.sampled_type, kind) for kind in (mi.BSDFFlags.Delta, mi.BSDFFlags.Null))
        return Chosen(drawn.wo, drawn.pdf, weight, drawn.eta, is_delta, is_null, joined, None)

    def by_cache(self, cache: GuideCache) -> Chosen:
        """Draw a share of the directions from the cache."""
        mi, dr, at = self.mi, self.dr, self.at
        spot = self._spot(cache)
        of_cache = self.draws[0] < self.share
        rest = (self.draws[0] - self.share) / dr.maximum(1 - self.share, 1e-6)
        rest = dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))
        asked = self.active & (self.share > 0)
        cell, local = cache.draw(spot.row, self.draws[1], asked & of_cache)
        drawn, weight, wo, value, density, joined = self._asked(at.to_local(spot.frame.to_world(local)), of_cache, rest)
        local = dr.select(of_cache, local, spot.frame.to_local(at.to_world(wo)))
        cell = dr.select(of_cache, cell, cache.cell(local))
        relative = cache.density(spot.row, cell, asked)
        is_delta = ~of_cache & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        above = dr.maximum(local.z, 0)
        mixed = dr.lerp(density, relative * above * dr.inv_pi, self.share)
        over = dr.select(mixed > 0, value / mixed, 0)
        joined = self._joined(joined[0], self._mixed(cache, spot, joined[1])) if self.joins else mi.Color3f(0)
        return Chosen(
            wo,
            dr.select(is_delta, drawn.pdf, mixed),
            dr.select(is_delta, weight / (1 - self.share), over),
            dr.select(of_cache, 1, drawn.eta),
            is_delta,
            ~of_cache & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null),
            joined,
            (mixed * dr.pi / dr.maximum(above, 1e-6), spot.place, cell),
        )

    def note(self, cache: GuideCache, records: Records, chosen: Chosen, depth: Any, path: tuple[Any, Any, Any]) -> None:
        """Note where the path went, by its weight, its light so far and its light before it was joined here."""
        dr = self.dr
        spot = self._spot(cache)
        local = spot.frame.to_local(self.at.to_world(chosen.wo))
        relative, place, cell = chosen.noted or (
            chosen.density * dr.pi / dr.maximum(local.z, 1e-6),
            spot.place,
            cache.cell(local),
        )
        active = self.active & (self.share > 0) & ~chosen.is_delta & (local.z > 1e-4)
        weight, light, shone = path
        bounce = Bounce(place * CELLS + cell, relative, weight, light, shone, self.at.p, spot.frame.n)
        records.put(depth, bounce, active)

    def _asked(self, guided: Any, of_cache: Any, draw: Any) -> tuple[Any, ...]:
        """What the material draws, its value and density in the direction taken and, of a join, in the emitter's."""
        mi, dr, joins = self.mi, self.dr, self.joins

        def ask(bsdf: Any, at: Any, guided: Any, aim: Any, of_cache: Any, draw: Any, point: Any, active: Any) -> Any:
            context = mi.BSDFContext()
            drawn, weight = bsdf.sample(context, at, draw, point, active & ~of_cache)
            wo = dr.select(of_cache, guided, drawn.wo)
            value, density = bsdf.eval_pdf(context, at, wo, active)
            joined = bsdf.eval_pdf(context, at, aim, active) if joins else (mi.Color3f(0), mi.Float(0))
            return drawn, weight, wo, value, density, joined

        aim = self.at.to_local(self.aim.d) if joins else mi.Vector3f(0, 0, 1)
        found: tuple[Any, ...] = dr.dispatch(
            self.bsdf, ask, self.at, guided, aim, of_cache, draw, self.draws[1], self.active
        )
        return found

    def _spot(self, cache: GuideCache) -> Any:
        normal = self.at.sh_frame.n
        return cache.spot(self.at.p, self.dr.select(self.at.wi.z < 0, -normal, normal))

    def _mixed(self, cache: GuideCache, spot: Any, density: Any) -> Any:
        """How densely cache and material together draw the emitter's direction."""
        dr = self.dr
        local = spot.frame.to_local(self.aim.d)
        relative = cache.density(spot.row, cache.cell(local), self.is_joined & (self.share > 0))
        return dr.lerp(density, relative * dr.maximum(local.z, 0) * dr.inv_pi, self.share)

    def _joined(self, value: Any, density: Any) -> Any:
        """Light of the emitter that the surface was joined to."""
        dr = self.dr
        share = dr.select(self.aim.delta, 1, self.tracer.share(self.aim.pdf, density))
        return dr.select(self.is_joined, share * value * self.emitted, 0)

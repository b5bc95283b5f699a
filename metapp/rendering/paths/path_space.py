"""Light paths as points of primary sample space: the random numbers from which a path tracer makes them.

A point holds the place on the film, x to the right and y down, then two numbers for the direction in which the path
leaves each of the first surfaces that scatter. Mirrors and glass, which leave no choice of direction, take none. All
further numbers of a path are drawn within the tracer. A path counts if it meets a light, without next-event
estimation; or, if the tracer has it, as :mod:`metapp.rendering.paths.next_event` says: the mean over these further
numbers is the same function of the point. Only light that point, spot and directional emitters send to the first
surface comes beside it.

A density q(directions | film) can guide pictures. One path of four is left to the uniform density (defensive sampling),
so that the weight 1 / (1/4 + 3/4 q) of a path is never above 4 (the balance heuristic of Veach & Guibas 1995): pictures
are unbiased for every density that is positive or zero, and noisier where it is wrong.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.rendering.scenes.loading import colour_luminance, load_scene, mitsuba_message
from metapp.rendering.scenes.rules import SceneDict
from metapp.rendering.types import Color, Point2, RandomStreams, Ray

POINT_DIMENSIONS = 4  # numbers of a point: a place on the film, and a direction at the first surface that scatters
DEPTH_EDGES = 6  # edges of the longest path
SAMPLE_IMAGE_PX = 32  # side of the picture that comes with samples, px
PATHS_PER_UNGUIDED = 4  # one path in so many is not guided
BELOW_ONE = 1 - 2**-24  # the greatest float32 below 1

BATCH_PATHS = 2**19  # paths traced at a time for samples
_PICTURE_PATHS = 2**18  # paths traced at a time for pictures
_REFERENCE_SPP = 2048  # paths a pixel of a reference
_MAX_BAD_SHARE, _MAX_BAD_PATHS = 1e-4, 8  # share and number of paths that may carry NaN or infinity, whichever is more
_MIN_ACCEPTED_SHARE = 2e-4  # share of the paths that become samples: at this one, 40,000 take two minutes on one core


class Tracer:
    """A tracer of the paths of one scene.

    Args:
        scene: a scene's dictionary, see :func:`metapp.rendering.scenes.loading.load_scene`.
        depth: edges of the longest path, as `max_depth` of Mitsuba's `path`.
        next_event: whether paths have next-event estimation; in a scene with a point, spot or directional emitter they
            have it anyway.
        batch_paths: number of paths that are traced at a time for samples; None for BATCH_PATHS; more take memory.

    Raises:
        ValueError: a scene that `load_scene` refuses.

    Attributes:
        mi: the module of Mitsuba, in its variant.
        scene: Mitsuba's object of the scene.
        greatest_luminance: the greatest luminance that its lights send out; 0 if they do not tell.
    """

    def __init__(
        self, scene: SceneDict, depth: int = DEPTH_EDGES, next_event: bool = False, batch_paths: int | None = None
    ) -> None:
        self.mi, self.scene, self.greatest_luminance = load_scene(scene)
        self.depth, self.batch_paths = depth, batch_paths or BATCH_PATHS
        flags = (emitter.flags() for emitter in self.scene.emitters())
        self.next_event = next_event or any(self.mi.has_flag(flag, self.mi.EmitterFlags.Delta) for flag in flags)

    def trace_radiance(self, points: Tensor, rng: Generator) -> Tensor:
        """Compute the radiance that paths carry to the film.

        Args:
            points: float32 [N, d] in [0, 1), d = 2, 4, 6, ...
            rng: draws all numbers that the points do not hold.

        Returns:
            float32 [N, 3], linear RGB radiance; its mean over all points at a place on the film is the radiance there,
            without the direct light of :meth:`trace_with_direct_light`.

        Raises:
            ValueError: Mitsuba loads the scene, but cannot trace a path in it, or many carry NaN.
        """
        return self.trace_with_direct_light(points, rng)[0]

    def trace_with_direct_light(self, points: Tensor, rng: Generator) -> tuple[Tensor, Tensor | float]:
        """Compute the radiance that paths carry to the film, and direct light beside it that no direction meets.

        Args:
            points: float32 [N, d] in [0, 1), d = 2, 4, 6, ...
            rng: draws all numbers that the points do not hold.

        Returns:
            Linear RGB radiance, float32 [N, 3]; and the light that point, spot and directional emitters send to the
            first surface that scatters, [N, 3], or 0 without next-event estimation.

        Raises:
            ValueError: Mitsuba loads the scene, but cannot trace a path in it, or many carry NaN.
        """
        mi = self.mi
        columns = [mi.Float(column.cpu().contiguous().numpy()) for column in points.T]
        pairs = [mi.Point2f(x, y) for x, y in zip(columns[::2], columns[1::2], strict=True)]
        with _name_untraceable_scene():
            from metapp.rendering.paths.next_event import trace_paths  # imports Mitsuba

            streams, rays = self.make_random_streams(len(points), rng), self.make_camera_rays(pairs[0])
            radiance, direct = trace_paths(self.scene, rays, pairs[1:], streams, self.depth, self.next_event)
            return _to_finite_tensor(radiance), _to_finite_tensor(direct) if self.next_event else 0.0

    def make_random_streams(self, count: int, rng: Generator) -> RandomStreams:
        """Return a Dr.Jit generator of `count` random streams.

        They are not alike, as neighbouring streams of PCG32 would be.
        """
        import drjit

        mi = self.mi
        key = int(torch.randint(2**32, (), generator=rng))
        lane = drjit.arange(mi.UInt32, count)
        # opaque: else kernels are compiled anew for each key
        state, sequence = mi.sample_tea_32(lane, drjit.opaque(mi.UInt32, key))
        return mi.PCG32(initstate=mi.UInt64(state), initseq=mi.UInt64(sequence))

    def make_camera_rays(self, film: Point2) -> Ray:
        """Return the rays through places on the film, of which the central square counts."""
        mi = self.mi
        sensor = self.scene.sensors()[0]
        width, height = sensor.film().crop_size()
        side = min(width, height)
        place = (film - 0.5) * mi.ScalarVector2f(side / width, side / height) + 0.5
        return sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))[0]


@contextlib.contextmanager
def _name_untraceable_scene() -> Iterator[None]:
    """Name the scene if Mitsuba loads it, but cannot trace it, such as one with a spectrum that has no colour."""
    reason = ""
    try:
        yield
    except RuntimeError as error:
        reason = mitsuba_message(error)
    # Raised outside the handler: Mitsuba's error would keep the scene alive, and its materials would be traced with the
    # next scene's.
    if reason:
        raise ValueError(f"no scene that Mitsuba can trace paths in: {reason}")


class TooFewPathsError(ValueError):
    """The error of a scene in which hardly any path meets a light."""


class ImageSum:
    """The sum of the radiance of paths in each pixel of a small picture, SAMPLE_IMAGE_PX a side."""

    def __init__(self) -> None:
        self._total = torch.zeros(3, SAMPLE_IMAGE_PX**2, dtype=torch.float64)
        self._hits = torch.zeros(SAMPLE_IMAGE_PX**2, dtype=torch.float64)

    def add(self, points: Tensor, radiance: Tensor) -> None:
        """Add the radiance of paths.

        Args:
            points: the paths' points, [N, d].
            radiance: their linear RGB radiance, [N, 3].
        """
        pixel = (points[:, 1] * SAMPLE_IMAGE_PX).long() * SAMPLE_IMAGE_PX + (points[:, 0] * SAMPLE_IMAGE_PX).long()
        self._hits += torch.bincount(pixel, minlength=SAMPLE_IMAGE_PX**2)
        self._total += torch.stack(
            [torch.bincount(pixel, channel.double(), SAMPLE_IMAGE_PX**2) for channel in radiance.T]
        )

    def mean(self) -> Tensor:
        """Return the mean of paths in each pixel, linear RGB, float32 [3, 32, 32]."""
        picture: Tensor = (
            (self._total / self._hits.clamp_min(1)).float().unflatten(1, (SAMPLE_IMAGE_PX, SAMPLE_IMAGE_PX))
        )
        return picture


def sample_by_rejection(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw points of primary sample space in proportion to the luminance of their paths, by rejection.

    A path is kept with a probability of its luminance over the lights' greatest, which none exceeds where surfaces
    conserve energy. Should one do so, the bound is raised to it and earlier samples are thinned. All random numbers
    of a path but the POINT_DIMENSIONS numbers of its point are marginalised.

    Args:
        tracer: the scene's tracer.
        count: number of points.
        rng: makes all draws.

    Returns:
        points float32 [count, POINT_DIMENSIONS], no two from one path; and the picture that all paths, kept or not, add
        up to, float32 [3, 32, 32], linear RGB.

    Raises:
        TooFewPathsError: hardly any path meets a light.
    """
    kept: list[Tensor] = []
    bound, traced_count, kept_count, batch_paths = tracer.greatest_luminance, 0, 0, tracer.batch_paths
    image = ImageSum()
    while kept_count < count:
        points = torch.rand(batch_paths, POINT_DIMENSIONS, generator=rng)
        radiance = tracer.trace_radiance(points, rng)
        brightness = colour_luminance(radiance)
        greatest = float(brightness.max())
        if greatest > bound:
            kept = [
                points_of_batch[torch.rand(len(points_of_batch), generator=rng) < bound / greatest]
                for points_of_batch in kept
            ]
            bound = greatest
        kept.append(points[torch.rand(batch_paths, generator=rng) * bound < brightness])
        image.add(points, radiance)
        traced_count, kept_count = traced_count + batch_paths, sum(map(len, kept))
        if kept_count < _MIN_ACCEPTED_SHARE * traced_count:
            raise TooFewPathsError(
                f"{kept_count} of {traced_count:,} paths meet a light, expected {_MIN_ACCEPTED_SHARE:.2%} or more; "
                "point the camera at surfaces that light reaches, or enlarge the lights."
            )
    return torch.cat(kept)[:count].contiguous(), image.mean()


def _to_finite_tensor(radiance: Color) -> Tensor:
    """Convert radiance from Dr.Jit to float32 [N, 3], finite."""
    return _drop_bad_paths(torch.from_numpy(radiance.numpy()).T.contiguous())


def _drop_bad_paths(radiance: Tensor) -> Tensor:
    """Set radiance [N, 3] to 0 where it is NaN or infinite, as rough materials carry it now and then at grazing angles.

    Raises:
        ValueError: more paths are bad than such materials explain.
    """
    bad = ~radiance.isfinite().all(1)
    if int(bad.sum()) > max(_MAX_BAD_PATHS, _MAX_BAD_SHARE * len(bad)):
        raise ValueError(
            f"{int(bad.sum()):,} of {len(bad):,} paths carry NaN or infinite values, expected finite ones; look for a "
            "material, texture or light whose numbers are out of range."
        )
    return radiance.masked_fill(bad[:, None], 0)


class Guide(NamedTuple):
    """A density of directions for places on the film, over the unit cube [0, 1)^k, k = 2 or 4.

    Attributes:
        sample: draws for places on the film [N, 2] directions [N, k], and returns them with their density [N] > 0, by
            torch's global generator.
        density: returns the density [N] >= 0 of directions [N, k] at places on the film [N, 2].
    """

    sample: Callable[[Tensor], tuple[Tensor, Tensor]]
    density: Callable[[Tensor, Tensor], Tensor]


def render_paths(tracer: Tracer, spp: int, size: int, seed: int = 0, guide: Guide | None = None) -> Tensor:
    """Render a picture [3, size, size], linear RGB radiance, by so many paths a pixel.

    Args:
        tracer: the scene's tracer.
        spp: paths a pixel; every fourth is not guided.
        size: side of the picture, px.
        seed: seed of all draws; torch's global generator stays as it was.
        guide: guide of directions; None is Mitsuba's own sampling of each material, the baseline.

    Raises:
        ValueError: spp or size below 1.
    """
    rng = Generator().manual_seed(seed)

    def render_points(film: Tensor, first: int) -> Tensor:
        if guide is None:
            indirect, direct = tracer.trace_with_direct_light(film, rng)
            return indirect + direct
        points, weight = _guide_directions(guide, film, first, rng)
        indirect, direct = tracer.trace_with_direct_light(points, rng)
        return indirect * weight[:, None] + direct

    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        return _average_pixels(render_points, spp, size, rng)


def render_reference(tracer: Tracer, size: int, spp: int = _REFERENCE_SPP, seed: int = 1) -> Tensor:
    """Render the picture that :func:`render_paths` tends to, with less noise.

    Mitsuba's `path` renders it, which has next-event estimation. A picture of 64 px takes 7 s on one core.

    Args:
        tracer: the scene's tracer.
        size: side of the picture, px.
        spp: paths a pixel.
        seed: seed of all draws.

    Returns:
        Linear RGB radiance [3, size, size].
    """
    mi, rng = tracer.mi, Generator().manual_seed(seed)
    integrator = mi.load_dict({"type": "path", "max_depth": tracer.depth, "rr_depth": tracer.depth + 1})

    def render_points(film: Tensor, first: int) -> Tensor:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(torch.randint(2**31, (), generator=rng)), len(film))
        place = mi.Point2f(*(mi.Float(column.contiguous().numpy()) for column in film.T))
        with _name_untraceable_scene():
            traced = integrator.sample(tracer.scene, sampler, tracer.make_camera_rays(place))[0]
        return _drop_bad_paths(torch.from_numpy(traced.numpy()).T)

    return _average_pixels(render_points, spp, size, rng)


def _guide_directions(guide: Guide, film: Tensor, first: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw points [N, 2 + k] and their weights [N]: directions of the guide, or, for every fourth path, uniform ones.

    Args:
        guide: the guide.
        film: places on the film, [N, 2].
        first: number of the first path in the picture.
        rng: draws uniform directions.
    """
    is_uniform = (torch.arange(first, first + len(film)) % PATHS_PER_UNGUIDED) == 0
    directions, density = guide.sample(film[~is_uniform])
    uniform_directions = torch.rand(int(is_uniform.sum()), directions.shape[1], generator=rng)
    points = film.new_empty(len(film), 2 + directions.shape[1])
    points[:, :2] = film
    points[~is_uniform, 2:], points[is_uniform, 2:] = directions.detach().to(film), uniform_directions
    densities = film.new_empty(len(film))
    densities[~is_uniform] = density.detach().to(film)
    densities[is_uniform] = guide.density(film[is_uniform], uniform_directions).detach().to(film)
    return points, 1 / (1 / PATHS_PER_UNGUIDED + (1 - 1 / PATHS_PER_UNGUIDED) * densities)


def _average_pixels(render_points: Callable[[Tensor, int], Tensor], spp: int, size: int, rng: Generator) -> Tensor:
    """Average radiance over each pixel of a picture.

    Args:
        render_points: returns radiance [N, 3] at places on the film [N, 2], by the number of the first path, too.
        spp: paths a pixel.
        size: side of the picture, px.
        rng: draws places within pixels.
    """
    if spp < 1 or size < 1:
        raise ValueError(f"picture of {size} px and {spp} paths a pixel, expected 1 or more of both.")
    total = torch.zeros(size * size, 3, dtype=torch.float64)
    offset = int(torch.randint(PATHS_PER_UNGUIDED, (), generator=rng))
    for first in range(0, size * size * spp, _PICTURE_PATHS):
        numbers = torch.arange(first, min(first + _PICTURE_PATHS, size * size * spp))
        pixels = numbers // spp
        corners = torch.stack([pixels % size, pixels // size], dim=1)
        film = (corners + torch.rand(len(numbers), 2, generator=rng)) / size
        total.index_add_(0, pixels, render_points(film, first + offset).double())
    return (total / spp).T.reshape(3, size, size).float()

"""Light paths as points of primary sample space: the random numbers from which a path tracer makes them.

A point holds the place on the film, x to the right and y down, then two numbers for the direction in which the path
leaves each of the first surfaces that scatter. Mirrors and glass, which leave no choice of direction, take none. All
further numbers of a path are drawn within. A path counts if it meets a light, without next-event estimation, or, where
the tracer has it, as `metapp.rendering.paths.next_event` says: the mean over these numbers is the same function
of the point. Only light that point, spot and directional emitters send to the first surface comes beside it.

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

POINT_DIMENSIONS = 4  # film, and the direction at the first surface that scatters
DEPTH_EDGES = 6  # edges of the longest path
SAMPLE_IMAGE_PX = 32  # px, side of the picture that comes with samples
PATHS_PER_UNGUIDED = 4  # one path in so many is not guided
BELOW_ONE = 1 - 2**-24

BATCH_PATHS = 2**19  # paths traced at a time for samples
_PICTURE_BATCH = 2**18
_REFERENCE_SPP = 2048
_BAD, _FEW = 1e-4, 8  # share and number of paths that may carry no number
_RAREST = 2e-4  # of the paths become samples: at this share, 40,000 take two minutes on one core


class Tracer:
    """Traces the paths of one scene.

    Args:
        scene: as `load_scene` takes it.
        depth: edges of the longest path, as `max_depth` of Mitsuba's `path`.
        next_event: whether paths have next-event estimation; those of a scene with a point, spot or directional emitter
            have it anyway.
        batch_paths: paths that are traced at a time for samples, None for BATCH_PATHS; more take memory.

    Raises:
        ValueError: as `load_scene`.
    """

    def __init__(
        self, scene: SceneDict, depth: int = DEPTH_EDGES, next_event: bool = False, batch_paths: int | None = None
    ) -> None:
        self.mi, self.scene, self.brightest = load_scene(scene)
        self.depth, self.batch_paths = depth, batch_paths or BATCH_PATHS
        flags = (emitter.flags() for emitter in self.scene.emitters())
        self.next_event = next_event or any(self.mi.has_flag(flag, self.mi.EmitterFlags.Delta) for flag in flags)

    def contributions(self, points: Tensor, rng: Generator) -> Tensor:
        """The radiance that paths carry to the film.

        Args:
            points: float32 [N, d] in [0, 1), d = 2, 4, 6, ...
            rng: of all numbers that the points do not hold.

        Returns:
            float32 [N, 3], linear RGB radiance; its mean over all points at a place on the film is the radiance there,
            without the light that `parts` has beside it.

        Raises:
            ValueError: Mitsuba loads the scene, but cannot trace a path in it, or many carry NaN.
        """
        return self.parts(points, rng)[0]

    def parts(self, points: Tensor, rng: Generator) -> tuple[Tensor, Tensor | float]:
        """The same, and light beside it that no direction meets, [N, 3], or 0: see `paths.next_event`."""
        mi = self.mi
        columns = [mi.Float(column.cpu().contiguous().numpy()) for column in points.T]
        pairs = [mi.Point2f(x, y) for x, y in zip(columns[::2], columns[1::2], strict=True)]
        with _traceable():
            from metapp.rendering.paths.next_event import trace_paths  # imports Mitsuba

            streams, rays = self.streams(len(points), rng), self.rays(pairs[0])
            carried, direct = trace_paths(self.scene, rays, pairs[1:], streams, self.depth, self.next_event)
            return _as_tensor(carried), _as_tensor(direct) if self.next_event else 0.0

    def streams(self, count: int, rng: Generator) -> RandomStreams:
        """A Dr.Jit generator of `count` random streams; unlike neighbouring streams of PCG32, they are not alike."""
        import drjit

        mi = self.mi
        key = int(torch.randint(2**32, (), generator=rng))
        lane = drjit.arange(mi.UInt32, count)
        state, sequence = mi.sample_tea_32(lane, drjit.opaque(mi.UInt32, key))  # opaque: else each is compiled anew
        return mi.PCG32(initstate=mi.UInt64(state), initseq=mi.UInt64(sequence))

    def rays(self, film: Point2) -> Ray:
        """The rays through places on the film, of which the central square counts."""
        mi = self.mi
        sensor = self.scene.sensors()[0]
        width, height = sensor.film().crop_size()
        side = min(width, height)
        place = (film - 0.5) * mi.ScalarVector2f(side / width, side / height) + 0.5
        return sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))[0]


@contextlib.contextmanager
def _traceable() -> Iterator[None]:
    """Name the scene if Mitsuba loads it, but cannot trace it, such as one with a spectrum that has no colour."""
    reason = ""
    try:
        yield
    except RuntimeError as error:
        reason = mitsuba_message(error)
    if (
        reason
    ):  # without the error, which would keep the scene alive: its materials would be traced with the next scene's
        raise ValueError(f"no scene that Mitsuba can trace paths in: {reason}")


class TooFewPathsError(ValueError):
    """Hardly any path meets a light."""


class ImageSum:
    """The picture that paths add up to."""

    def __init__(self) -> None:
        self._total = torch.zeros(3, SAMPLE_IMAGE_PX**2, dtype=torch.float64)
        self._hits = torch.zeros(SAMPLE_IMAGE_PX**2, dtype=torch.float64)

    def add(self, points: Tensor, carried: Tensor) -> None:
        """Add the radiance [N, 3] of paths of points [N, d]."""
        pixel = (points[:, 1] * SAMPLE_IMAGE_PX).long() * SAMPLE_IMAGE_PX + (points[:, 0] * SAMPLE_IMAGE_PX).long()
        self._hits += torch.bincount(pixel, minlength=SAMPLE_IMAGE_PX**2)
        self._total += torch.stack(
            [torch.bincount(pixel, channel.double(), SAMPLE_IMAGE_PX**2) for channel in carried.T]
        )

    def mean(self) -> Tensor:
        """Linear RGB, float32 [3, 32, 32]."""
        picture: Tensor = (
            (self._total / self._hits.clamp_min(1)).float().unflatten(1, (SAMPLE_IMAGE_PX, SAMPLE_IMAGE_PX))
        )
        return picture


def sample_by_rejection(tracer: Tracer, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Points of primary sample space in proportion to the luminance of their paths, by rejection.

    A path is kept with a probability of its luminance over the lights' greatest, which none exceeds where surfaces
    conserve energy. Should one do so, the bound is raised to it and earlier samples are thinned. All random numbers
    of a path but DIMENSIONS are marginalised.

    Args:
        tracer: of the scene.
        count: points wanted.
        rng: of all draws.

    Returns:
        points float32 [count, DIMENSIONS], no two from one path; and the picture that all paths, kept or not, add up
        to, float32 [3, 32, 32], linear RGB.

    Raises:
        FewPaths: hardly any path meets a light.
    """
    kept: list[Tensor] = []
    bound, traced, have, batch = tracer.brightest, 0, 0, tracer.batch_paths
    image = ImageSum()
    while have < count:
        points = torch.rand(batch, POINT_DIMENSIONS, generator=rng)
        carried = tracer.contributions(points, rng)
        bright = colour_luminance(carried)
        highest = float(bright.max())
        if highest > bound:
            kept = [part[torch.rand(len(part), generator=rng) < bound / highest] for part in kept]
            bound = highest
        kept.append(points[torch.rand(batch, generator=rng) * bound < bright])
        image.add(points, carried)
        traced, have = traced + batch, sum(map(len, kept))
        if have < _RAREST * traced:
            raise TooFewPathsError(
                f"{have} of {traced:,} paths meet a light, expected {_RAREST:.2%} or more; point the camera at "
                "surfaces that light reaches, or enlarge the lights."
            )
    return torch.cat(kept)[:count].contiguous(), image.mean()


def _as_tensor(carried: Color) -> Tensor:
    """Float32 [N, 3], finite."""
    return _finite(torch.from_numpy(carried.numpy()).T.contiguous())


def _finite(carried: Tensor) -> Tensor:
    """The same with 0 for paths that carry NaN or infinity, as rough materials do now and then at grazing angles."""
    bad = ~carried.isfinite().all(1)
    if int(bad.sum()) > max(_FEW, _BAD * len(bad)):
        raise ValueError(
            f"{int(bad.sum()):,} of {len(bad):,} paths carry NaN or infinite values, expected finite ones; look for a "
            "material, texture or light whose numbers are out of range."
        )
    return carried.masked_fill(bad[:, None], 0)


class Guide(NamedTuple):
    """A density of directions for places on the film, over the unit cube [0, 1)^k, k = 2 or 4.

    Attributes:
        sample: film [N, 2] to directions [N, k] and their density [N] > 0, by torch's own random numbers.
        density: film [N, 2] and directions [N, k] to the density [N] >= 0.
    """

    sample: Callable[[Tensor], tuple[Tensor, Tensor]]
    density: Callable[[Tensor, Tensor], Tensor]


def render_paths(tracer: Tracer, spp: int, size: int, seed: int = 0, guide: Guide | None = None) -> Tensor:
    """A picture [3, size, size], linear RGB radiance, of so many paths a pixel.

    Args:
        tracer: of the scene.
        spp: paths a pixel; every fourth is not guided.
        size: side of the picture, px.
        seed: of all draws; torch's global generator stays as it was.
        guide: of directions; None is Mitsuba's own sampling of each material, the baseline.

    Raises:
        ValueError: spp or size below 1.
    """
    rng = Generator().manual_seed(seed)

    def radiance(film: Tensor, first: int) -> Tensor:
        if guide is None:
            carried, beside = tracer.parts(film, rng)
            return carried + beside
        points, weight = _guided(guide, film, first, rng)
        carried, beside = tracer.parts(points, rng)
        return carried * weight[:, None] + beside

    with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
        torch.manual_seed(seed)
        return _picture(radiance, spp, size, rng)


def render_reference(tracer: Tracer, size: int, spp: int = _REFERENCE_SPP, seed: int = 1) -> Tensor:
    """The picture that `render_paths` tends to, with less noise: Mitsuba's `path`, which has next-event estimation.

    Arguments and result are those of `render_paths`; 64 px take 7 s on one core.
    """
    mi, rng = tracer.mi, Generator().manual_seed(seed)
    integrator = mi.load_dict({"type": "path", "max_depth": tracer.depth, "rr_depth": tracer.depth + 1})

    def radiance(film: Tensor, first: int) -> Tensor:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(torch.randint(2**31, (), generator=rng)), len(film))
        place = mi.Point2f(*(mi.Float(column.contiguous().numpy()) for column in film.T))
        with _traceable():
            carried = integrator.sample(tracer.scene, sampler, tracer.rays(place))[0]
        return _finite(torch.from_numpy(carried.numpy()).T)

    return _picture(radiance, spp, size, rng)


def _guided(guide: Guide, film: Tensor, first: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Points [N, 2 + k] and their weights [N]: directions of the guide, or, every fourth, uniform ones."""
    uniform = (torch.arange(first, first + len(film)) % PATHS_PER_UNGUIDED) == 0
    directions, density = guide.sample(film[~uniform])
    others = torch.rand(int(uniform.sum()), directions.shape[1], generator=rng)
    points = film.new_empty(len(film), 2 + directions.shape[1])
    points[:, :2] = film
    points[~uniform, 2:], points[uniform, 2:] = directions.detach().to(film), others
    densities = film.new_empty(len(film))
    densities[~uniform] = density.detach().to(film)
    densities[uniform] = guide.density(film[uniform], others).detach().to(film)
    return points, 1 / (1 / PATHS_PER_UNGUIDED + (1 - 1 / PATHS_PER_UNGUIDED) * densities)


def _picture(radiance: Callable[[Tensor, int], Tensor], spp: int, size: int, rng: Generator) -> Tensor:
    """The mean over each pixel of the radiance at places on the film, numbered from its second argument on."""
    if spp < 1 or size < 1:
        raise ValueError(f"picture of {size} px and {spp} paths a pixel, expected 1 or more of both.")
    total = torch.zeros(size * size, 3, dtype=torch.float64)
    offset = int(torch.randint(PATHS_PER_UNGUIDED, (), generator=rng))
    for first in range(0, size * size * spp, _PICTURE_BATCH):
        number = torch.arange(first, min(first + _PICTURE_BATCH, size * size * spp))
        pixel = number // spp
        corner = torch.stack([pixel % size, pixel // size], dim=1)
        film = (corner + torch.rand(len(number), 2, generator=rng)) / size
        total.index_add_(0, pixel, radiance(film, first + offset).double())
    return (total / spp).T.reshape(3, size, size).float()

"""Paths by their random numbers: as Mitsuba renders them, as samples in exact proportion, and guided in pictures."""

import copy
import math
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from data_tools.synthetic.cornell import random_scene, rgb_entry
from metapp.rendering.paths import path_space
from metapp.rendering.paths.path_space import (
    SAMPLE_IMAGE_PX,
    Guide,
    TooFewPathsError,
    Tracer,
    render_paths,
    render_reference,
    sample_by_rejection,
)
from metapp.rendering.paths.resampling import draw_path_samples, sample_by_resampling
from metapp.rendering.scenes.loading import colour_luminance, load_scene
from metapp.rendering.scenes.rules import box_film
from metapp.rendering.scenes.stored_text import decode_scene, encode_scene
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba

CELLS = 8  # of the film, per side


def seeded(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def cell_means(tracer: Tracer, count: int, dimensions: int) -> tuple[Tensor, Tensor]:
    """Mean luminance of cells of the film [8, 8], row by row, and its standard errors."""
    rng = seeded()
    points = torch.rand(count, dimensions, generator=rng)
    values = colour_luminance(tracer.trace_radiance(points, rng)).double()
    cell = (points[:, 1] * CELLS).long() * CELLS + (points[:, 0] * CELLS).long()
    hits, first, second = (torch.bincount(cell, values**power, CELLS**2) for power in (0, 1, 2))
    mean = first / hits
    return mean.view(CELLS, CELLS), ((second / hits - mean**2) / hits).sqrt().view(CELLS, CELLS)


def mitsuba_means(scene: dict[str, Any], depth: int, runs: int = 16) -> tuple[Tensor, Tensor]:
    """Return means and standard errors of cells of the film by Mitsuba's path integrator, without the tracer's code."""
    loaded = load_scene({**scene, "sensor": {**scene["sensor"], "film": box_film(CELLS, CELLS)}})
    mi = loaded.mitsuba
    path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 100})
    pictures = [mi.render(loaded.scene, integrator=path, spp=128, seed=seed).numpy() for seed in range(runs)]
    values = torch.stack([colour_luminance(torch.from_numpy(picture).reshape(-1, 3)) for picture in pictures]).double()
    return values.mean(0).view(CELLS, CELLS), (values.std(0) / math.sqrt(runs)).view(CELLS, CELLS)


@needs_mitsuba
@pytest.mark.parametrize(
    ("seed", "depth", "dimensions", "next_event"),
    [(0, 6, 4, False), (4, 4, 6, False), long(2, 6, 4, True), long(4, 4, 6, True)],
)
def test_tracer_agrees_with_mitsuba(seed: int, depth: int, dimensions: int, next_event: bool) -> None:
    scene = random_scene(seed)
    ours, our_error = cell_means(Tracer(scene, depth, next_event=next_event), 2**20, dimensions)
    theirs, their_error = mitsuba_means(scene, depth)
    deviation = (ours - theirs) / (our_error**2 + their_error**2).sqrt()
    assert deviation.abs().max() < 4.5
    assert 0.5 < deviation.square().mean() < 1.6
    assert float(ours.mean()) == pytest.approx(float(theirs.mean()), rel=0.02)
    assert (our_error / ours).median() < 0.1  # or it would say little


@needs_mitsuba
def test_furnace_scene_is_as_bright_as_its_surroundings() -> None:
    # under an even sky a convex surface sends out its albedo, path by path
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 30, "film": box_film(4, 4)},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1.0, 2.0, 3.0]}},
        "ball": {"type": "sphere", "center": [0, 0, 10], "radius": 8.0,
                 "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.25, 0.125]}}},
    }  # fmt: skip
    tracer = Tracer(scene)
    rng = seeded()
    carried = tracer.trace_radiance(torch.rand(4096, 4, generator=rng), rng)
    torch.testing.assert_close(carried, torch.tensor([0.5, 0.5, 0.375]).expand(4096, -1))
    assert tracer.greatest_luminance == pytest.approx(float(colour_luminance(torch.tensor([[1.0, 2.0, 3.0]]))))


@needs_mitsuba
def test_directions_are_for_surfaces_that_scatter() -> None:
    # seen in a mirror, the floor still takes the point's numbers: nothing is left to chance
    scene = {
        key: value for key, value in random_scene(1).items() if key in ("type", "sensor", "floor", "back", "light")
    }
    mirror = {"type": "conductor", "material": "none", "specular_reflectance": {"type": "rgb", "value": [0.8] * 3}}
    scene["back"] = {**scene["back"], "bsdf": mirror}
    tracer = Tracer(scene, depth=4)
    points = torch.rand(2**17, 4, generator=seeded())
    carried = tracer.trace_radiance(points, seeded(1))
    assert torch.equal(carried, tracer.trace_radiance(points, seeded(2)))
    assert not torch.equal(carried[:, 0] > 0, tracer.trace_radiance(points[:, :2], seeded(2))[:, 0] > 0)
    in_mirror = (points[:, 1] > 0.72) & (points[:, 1] < 0.79)  # the floor itself ends at 0.796, its image at 0.71
    assert (carried[in_mirror] > 0).sum() > 20


class _Sloped:
    """Stands for a tracer: what a path carries grows along one axis, to `most`, whatever bound it states."""

    batch_paths = 1000

    def __init__(self, brightest: float, most: float = 2.0) -> None:
        self.greatest_luminance, self.most = brightest, most

    def trace_radiance(self, points: Tensor, rng: Generator) -> Tensor:
        return self.most * points[:, 2:3].expand(-1, 3)


@pytest.mark.parametrize("brightest", [0.0, 1.3, 2.0, 5.0])
def test_a_bound_that_is_exceeded_is_raised(brightest: float) -> None:
    points, image = sample_by_rejection(_Sloped(brightest), 100_000, seeded())  # type: ignore[arg-type]
    # of a density 2 x the cumulative distribution is x^2; Kolmogorov and Smirnov's distance is below 2 / sqrt(N)
    place = points[:, 2].sort().values.double()
    assert float((place**2 - torch.arange(len(place)) / len(place)).abs().max()) < 2 / math.sqrt(len(place))
    assert image.shape == (3, SAMPLE_IMAGE_PX, SAMPLE_IMAGE_PX)
    assert float(image.mean()) == pytest.approx(1, abs=0.02)


def test_scenes_without_light_in_view_are_refused() -> None:
    with pytest.raises(ValueError, match=r"0 of [\d,]+ paths meet a light, expected 0.02% or more; point the camera"):
        sample_by_rejection(_Sloped(1.0, most=0.0), 100, seeded())  # type: ignore[arg-type]


@needs_mitsuba
def test_a_wide_film_counts_in_its_central_square() -> None:
    scene = random_scene(2)
    sensor = {**scene["sensor"], "fov_axis": "smaller"}
    square, wide = (
        cell_means(Tracer({**scene, "sensor": {**sensor, "film": box_film(*size)}}), 2**18, 4)[0]
        for size in ((64, 64), (160, 64))
    )
    torch.testing.assert_close(square, wide, rtol=1e-3, atol=1e-3)


# Pictures

RUNS, SIZE, SPP = 8, 8, 512


def slope(film: Tensor) -> Tensor:
    """Return the slope of the guide's density over each number at places on the film, [N, 1] in [0, 1)."""
    return 0.95 * film[:, :1]


def density(film: Tensor, directions: Tensor) -> Tensor:
    """The product over the numbers of 1 + slope * (2 u - 1)."""
    return (1 + slope(film) * (2 * directions - 1)).prod(1)


def sloped_guide(dimensions: int = 2) -> Guide:
    """A guide that knows nothing of the scene, with a closed form."""

    def sample(film: Tensor) -> tuple[Tensor, Tensor]:
        uniform, steep = torch.rand(len(film), dimensions), slope(film)
        # the inverse of u + slope * (u^2 - u), stable at a slope of 0
        root = ((1 - steep) ** 2 + 4 * steep * uniform).sqrt()
        directions = (2 * uniform / (1 - steep + root)).clamp(0, 1 - 1e-7)
        return directions, density(film, directions)

    return Guide(sample, density)


def means(tracer: Tracer, guide: Guide | None, runs: int = RUNS) -> Tensor:
    """Return the means [runs] of the lower halves of several pictures, where the light itself is not seen."""
    pictures = [render_paths(tracer, SPP, SIZE, seed, guide)[:, SIZE // 2 :] for seed in range(runs)]
    return torch.stack([picture.mean() for picture in pictures]).double()


def deviation(first: Tensor, second: Tensor) -> float:
    """The difference of two means, in standard errors."""
    error = (first.var() / len(first) + second.var() / len(second)).sqrt()
    return float((first.mean() - second.mean()) / error)


@needs_mitsuba
@pytest.mark.parametrize("seed", [1, 4])
def test_a_guided_picture_has_the_same_mean(seed: int) -> None:
    tracer = Tracer(random_scene(seed))
    regular, guided = means(tracer, None), means(tracer, sloped_guide(4 if seed == 4 else 2))
    assert abs(deviation(regular, guided)) < 3
    error = (regular.var() + guided.var()).sqrt() / math.sqrt(RUNS)
    assert float(error / regular.mean()) < 0.04  # or the above would say little


def corner(stated: float) -> Guide:
    """A guide whose directions all lie in one corner, of density 16, and the density it states."""

    def sample(film: Tensor) -> tuple[Tensor, Tensor]:
        return 0.25 * torch.rand(len(film), 2), torch.full((len(film),), stated)

    return Guide(sample, lambda film, directions: stated * (directions < 0.25).all(1).float())


@needs_mitsuba
def test_a_guide_away_from_light_biases_only_with_wrong_density() -> None:
    tracer = Tracer(random_scene(1))
    regular = means(tracer, None)
    assert abs(deviation(regular, means(tracer, corner(16.0)))) < 3
    assert abs(deviation(regular, means(tracer, corner(1.0)))) > 3


@needs_mitsuba
def test_pictures_converge_to_the_reference() -> None:
    tracer = Tracer(random_scene(3))
    ours = torch.stack([render_paths(tracer, 256, SIZE, seed) for seed in range(RUNS)]).double()
    theirs = torch.stack([render_reference(tracer, SIZE, 128, seed) for seed in range(RUNS)]).double()
    assert abs(deviation(ours.mean((1, 2, 3)), theirs.mean((1, 2, 3)))) < 3
    errors = (ours.var(0) / RUNS + theirs.var(0) / RUNS).sqrt()
    assert float(((ours - theirs).mean(0) / errors).abs().median()) < 1.2  # pixel by pixel
    dark = ours.mean((0, 1)) < ours.mean((0, 1)).median()
    assert float(theirs.var(0).sum(0)[dark].median()) < float(ours.var(0).sum(0)[dark].median()) / 4


@needs_mitsuba
def test_a_picture_depends_on_the_seed_alone() -> None:
    scene = random_scene(2)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    first = render_paths(Tracer(scene), 4, 16, 7, sloped_guide())
    assert torch.equal(torch.rand(3), expected)  # of others
    assert first.shape == (3, 16, 16)
    assert first.dtype is torch.float32
    assert torch.equal(first, render_paths(Tracer(decode_scene(encode_scene(scene))), 4, 16, 7, sloped_guide()))
    assert not torch.equal(first, render_paths(Tracer(scene), 4, 16, 8, sloped_guide()))
    for spp, size in ((0, 8), (1, 0)):
        with pytest.raises(ValueError, match="expected 1 or more of both"):
            render_paths(Tracer(scene), spp, size)


@needs_mitsuba
def test_pixels_are_where_they_belong() -> None:
    # the light hangs below the ceiling, in the upper half; a picture in pieces is the picture
    picture = render_paths(Tracer(random_scene(1)), 16, 32, 0)
    brightest = int(picture.sum(0).argmax())
    assert brightest // 32 < 12
    light = torch.tensor(random_scene(1)["light"]["to_world"])[:3, 3]
    column = (0.5 + 0.5 * light[0] / ((3.9 - light[2]) * math.tan(math.radians(19)))) * 32
    assert abs(brightest % 32 - float(column)) < 6


def test_few_paths_of_nan_count_as_dark_and_many_are_refused() -> None:
    carried = torch.ones(1000, 3)
    carried[3, 1], carried[5, 0] = float("nan"), float("inf")
    found = path_space._drop_bad_paths(carried)
    assert found.isfinite().all()
    assert found.sum() == 3 * 998
    carried[10:20] = float("nan")
    with pytest.raises(ValueError, match="12 of 1,000 paths carry NaN or infinite values"):
        path_space._drop_bad_paths(carried)


# Next-event estimation


Scene = dict[str, Any]


def small_lamp(seed: int, times: float) -> Scene:
    """A Cornell box whose lamp has sides so many times shorter, and the same power."""
    scene: Scene = copy.deepcopy(random_scene(seed))
    lamp = scene["light"]
    lamp["to_world"] = [[*(value / times for value in row[:2]), *row[2:]] for row in lamp["to_world"]]
    radiance = lamp["emitter"]["radiance"]["value"]
    lamp["emitter"]["radiance"] = rgb_entry([times**2 * value for value in radiance])
    return scene


def bulb(seed: int, **more: Any) -> Scene:
    """A Cornell box with a point light instead of its lamp."""
    scene = {key: value for key, value in random_scene(seed).items() if key != "light"}
    return {**scene, "bulb": {"type": "point", "position": [0.1, 0.7, 0.0], "intensity": rgb_entry([1.0] * 3)}, **more}


class _Steep:
    """Stands for a tracer: paths that carry 3 u^2 along one number, by a noise whose mean is 1."""

    next_event, batch_paths = True, 2**16

    def trace_radiance(self, points: Tensor, rng: Generator) -> Tensor:
        noise = 4.0 * (torch.rand(len(points), 1, generator=rng) < 0.25)
        return (3 * points[:, 2:3] ** 2 * noise).expand(-1, 3)


def test_moves_leave_the_density_of_a_noisy_function_as_it_is() -> None:
    points, image = sample_by_resampling(_Steep(), 20_000, Generator().manual_seed(0))  # type: ignore[arg-type]
    # of a density 3 x^2 the cumulative distribution is x^3; Kolmogorov and Smirnov's distance is below 2 / sqrt(N)
    place = points[:, 2].sort().values.double()
    assert float((place**3 - torch.arange(len(place)) / len(place)).abs().max()) < 2 / math.sqrt(len(place))
    assert float(image.mean()) == pytest.approx(1, abs=0.05)


@pytest.mark.long
@needs_mitsuba
def test_samples_are_resampled_only_if_few_paths_meet_a_light() -> None:
    plain, small = (Tracer(scene, batch_paths=2**16) for scene in (random_scene(0), small_lamp(0, 12)))
    expected = sample_by_rejection(plain, 500, Generator().manual_seed(3))
    found = draw_path_samples(plain, 500, Generator().manual_seed(3))
    assert not plain.next_event
    assert all(map(torch.equal, expected, found))  # bit for bit
    with pytest.raises(TooFewPathsError, match="meet a light"):
        sample_by_rejection(small, 500, Generator())
    points, _ = draw_path_samples(small, 500, Generator())
    assert small.next_event
    assert points.shape == (500, 4)


@needs_mitsuba
@pytest.mark.parametrize("scene", [bulb(1), long(small_lamp(3, 2))], ids=["bulb", "small"])
def test_pictures_agree_with_the_reference_tracer(scene: Scene) -> None:
    tracer = Tracer(scene, next_event=True)
    guide = corner(16.0)
    expected = float(render_reference(tracer, 8, 8192)[:, 4:].mean())  # the lower half, without the lamp
    for guide_of_run in (None, guide):
        shots = torch.stack(
            [render_paths(tracer, 512, 8, seed, guide_of_run)[:, 4:].mean() for seed in range(8)]
        ).double()
        error = float(shots.std() / len(shots) ** 0.5)
        assert abs(float(shots.mean()) - expected) < 3.5 * error + 0.003 * expected
        assert error < 0.1 * expected


@needs_mitsuba
def test_weights_are_of_the_power_heuristic() -> None:
    from metapp.rendering.jit import mi
    from metapp.rendering.paths.next_event import mis_weight

    weight = mis_weight(mi.Float([1, 2, 0, 5]), mi.Float([3, 0, 1, 5]))
    assert weight.numpy() == pytest.approx([0.1, 1, 0, 0.5])

"""The procedural materials and the patterns they are made of: ranges, periods, statistics."""

import math
from typing import Any

import numpy as np
import pytest
import torch

from data_tools.random_streams import random_stream
from data_tools.synthetic.environments.backdrop import open_ground
from data_tools.synthetic.environments.light import render_environment, sun_disc
from data_tools.synthetic.environments.patterns import direction, vector
from data_tools.synthetic.environments.scene_geometry import (
    Backdrop,
    Box,
    EnvironmentScene,
    Finish,
    Lamp,
    Window,
    view_rays,
)
from data_tools.synthetic.environments.sky import Sky, add_clouds, black_sky, clear_sky, sun_irradiance
from data_tools.synthetic.patterns.fields import height_slopes
from data_tools.synthetic.random_values import Field
from data_tools.synthetic.stationary.families import FAMILIES
from data_tools.synthetic.stationary.periodic_maps import PeriodicMaps
from metapp.appearance.latlong import cosine_transfer

SIZE = 128
BOUNDS = {"diffuse": (0.0, 1.0), "specular": (0.02, 0.9), "roughness": (0.05, 1.0)}


@pytest.fixture(scope="module", params=FAMILIES)
def draws(request: pytest.FixtureRequest) -> list[PeriodicMaps]:
    """Eight draws of a family."""
    return [FAMILIES[request.param](random_stream(7, member), SIZE) for member in range(8)]


def border_jump(field: Field, axis: int) -> float:
    """The step over the border, from the last row or column to the first, over the largest step inside."""
    steps = np.abs(np.roll(field, -1, axis) - field).mean(tuple({0, 1, 2} - {axis}))
    return float(steps[-1] / max(steps[:-1].max(), 1e-6))


def test_maps_have_their_shapes_and_ranges(draws: list[PeriodicMaps]) -> None:
    for maps in draws:
        assert [values.shape for values in maps] == [(channels, SIZE, SIZE) for channels in (3, 1, 1, 1)]
        assert all(values.dtype == np.float32 for values in maps)
        assert all(np.isfinite(values).all() for values in maps)
        for name, (low, high) in BOUNDS.items():
            values = getattr(maps, name)
            assert low <= values.min() + 1e-6, name
            assert values.max() <= high + 1e-6, name
        assert maps.diffuse.std() > 1e-3
        assert maps.diffuse.mean() > 0.01
        steepness = np.sqrt(sum(slope**2 for slope in height_slopes(maps.height[0])).mean())
        assert 1e-3 < steepness < 1.5


def test_materials_repeat_without_a_border(draws: list[PeriodicMaps]) -> None:
    for maps in draws:
        for field in (maps.diffuse, maps.height, maps.roughness):
            for axis in (1, 2):
                assert border_jump(field, axis) < 1.25


# Procedural environments


DARK = Backdrop(black_sky(), np.zeros_like, lambda rays: np.ones(rays.shape[1], np.float32))
BRIGHT = DARK._replace(radiance=np.ones_like)  # radiance 1 from everywhere
WHITE = vector(1, 1, 1)


def room(albedo: float = 0.5, backdrop: Backdrop = DARK) -> EnvironmentScene:
    """5 m wide, 2.7 m high, 5 m deep."""
    finish = Finish(WHITE * np.float32(albedo))
    return EnvironmentScene(vector(-2, -1.5, -3), vector(3, 1.2, 2), [finish] * 6, backdrop)


def plain(sky: Sky, albedo: float = 0.2) -> EnvironmentScene:
    """Open ground, 1.5 m below the eye."""
    finish = Finish(WHITE * np.float32(albedo))
    low = vector(-np.inf, -1.5, -np.inf)
    return EnvironmentScene(
        low, np.full(3, np.inf, np.float32), [finish] * 6, open_ground(sky, finish.colour), kept_light_share=0.0
    )


def clear(elevation_deg: float, azimuth_deg: float = 40.0, turbidity: float = 3.0) -> Sky:
    sun = direction(math.radians(elevation_deg), math.radians(azimuth_deg))
    return Sky(sun, sun_irradiance(math.radians(elevation_deg), turbidity), clear_sky(sun, turbidity))


# The sun in a map


@pytest.mark.parametrize("elevation_deg", [3, 35, 88])
@pytest.mark.parametrize("supersampling", [1, 2, 3])
def test_the_sun_keeps_its_energy_and_its_place(supersampling: int, elevation_deg: float) -> None:
    sky = clear(elevation_deg, azimuth_deg=123)
    rays, angles = view_rays(supersampling)
    disc = sun_disc(sky, rays, angles)
    np.testing.assert_allclose(disc @ angles, sky.sunlight, rtol=1e-4)
    mean = rays @ (disc[1] * angles)
    assert mean @ sky.sun / np.linalg.norm(mean) > math.cos(math.radians(0.6))
    assert rays[:, disc[1] > 0].T @ sky.sun == pytest.approx(1, abs=1 - math.cos(math.radians(6 / supersampling)))


# Light


@pytest.mark.parametrize(("elevation_deg", "seed"), [(15, None), (60, None), (40, 1), (25, 4)])
def test_ground_is_lit_by_all_that_is_above_it(elevation_deg: float, seed: int | None) -> None:
    sky = clear(elevation_deg) if seed is None else add_clouds(random_stream(seed), clear(elevation_deg), 0.5)
    light = render_environment(plain(sky, 0.2), 0.0)
    above = light.copy()
    above[:, 32:] = 0
    up = cosine_transfer(torch.tensor([[0.0, 1.0, 0.0]]), 64, 128)[0].numpy()
    np.testing.assert_allclose(light[:, 36:].mean((1, 2)), 0.2 * above.reshape(3, -1) @ up, rtol=0.02)


def mitsuba_room(
    mitsuba: Any, scene: EnvironmentScene, emitter: dict[str, Any], target: tuple[float, float, float]
) -> Field:
    """Green radiance [16, 16] that a path tracer sees, 80 degrees wide around a direction."""
    at, transform = [0.0, 0.0, 0.0], mitsuba.ScalarTransform4f
    gray = float(scene.sides[0].colour[1])
    bsdf = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": {"type": "rgb", "value": gray}}}

    def cube(low: Field, high: Field) -> dict[str, Any]:
        placed = transform().translate(((low + high) / 2).tolist()).scale(((high - low) / 2).tolist())
        return {"type": "cube", "to_world": placed, "bsdf": bsdf}

    described: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": 12}, "emitter": emitter}
    described |= {f"box{k}": cube(box.low, box.high) for k, box in enumerate(scene.boxes)}
    described["room"] = cube(scene.low, scene.high)
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    described["sensor"] = {"type": "perspective", "fov": 80.0, "film": film,
                           "to_world": transform().look_at(at, list(target), [0.0, 1.0, 0.01])}  # fmt: skip
    image: Field = np.array(mitsuba.render(mitsuba.load_dict(described), spp=48, seed=1))[..., 1]
    return image


def seen_in(light: Field, target: tuple[float, float, float]) -> Field:
    """Return the green radiance [16, 16] that an environment map shows, 80 degrees wide around a direction."""
    forward = np.array(target) / np.linalg.norm(target)
    right = np.cross(forward, [0, 1, 0.01])
    right /= np.linalg.norm(right)
    ticks = ((np.arange(64) + 0.5) / 32 - 1) * math.tan(math.radians(40))
    rays = (
        forward[:, None, None] + ticks * right[:, None, None] - (ticks * np.cross(right, forward)[:, None])[:, :, None]
    )
    rays /= np.linalg.norm(rays, axis=0)
    rows, places = np.arccos(rays[1]) / math.pi * 64, np.arctan2(rays[0], -rays[2]) / math.tau * 128
    found: Field = light[1][rows.astype(int), np.floor(places).astype(int) % 128]
    return found.reshape(16, 4, 16, 4).mean((1, 3))


@pytest.mark.parametrize("lit_by", ["lamp", "window"])
def test_rooms_are_lit_as_by_a_path_tracer(mitsuba: Any, lit_by: str) -> None:
    scene, transform = room(0.5, BRIGHT if lit_by == "window" else DARK), mitsuba.ScalarTransform4f
    scene.boxes = [Box(vector(-1.5, -1.5, -2.5), vector(-0.3, -0.6, -1.2), scene.sides[0])]
    if lit_by == "lamp":
        scene.lamps = [Lamp(vector(1, 1.19, -1), vector(0.4, 0, 0), vector(0, 0, 0.3), 10 * WHITE)]
        placed, radiance = transform().translate([1.0, 1.19, -1.0]).rotate([1, 0, 0], 90).scale([0.4, 0.3, 1.0]), 10.0
    else:
        scene.windows = [Window(1, (-2.0, -0.8), (0.5, 0.8), WHITE)]
        placed = transform().translate([2.999, 0.0, -0.75]).rotate([0, 1, 0], -90).scale([1.25, 0.8, 1.0])
        radiance = 1.0
    emitter = {"type": "rectangle", "to_world": placed,
               "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}}}  # fmt: skip
    light = render_environment(scene, 0.0)
    for target in ((0.0, -1.0, 0.02), (0.0, 1.0, 0.02), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)):
        theirs, ours = mitsuba_room(mitsuba, scene, emitter, target), seen_in(light, target)
        walls = theirs < radiance / 3
        assert np.median(ours[walls] / theirs[walls]) == pytest.approx(1, abs=0.12)
        assert np.quantile(np.abs(ours[walls] / theirs[walls] - 1), 0.9) < 0.4


# Skies

"""Skies: against Mitsuba's, and what clouds, haze and horizons do to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from data_tools.draws import Field, stream
from data_tools.synthetic.environments.backdrop import skyline
from data_tools.synthetic.environments.patterns import direction, glowing, luminance, vector
from data_tools.synthetic.environments.scene import view
from data_tools.synthetic.environments.sky import Sky, clear_sky, cloudy, day_sky, night_sky, overcast, sun_irradiance
from metapp.appearance.latlong import directions, solid_angles

WHITE = vector(1, 1, 1)


def clear(elevation_deg: float, azimuth_deg: float = 40.0, turbidity: float = 3.0) -> Sky:
    sun = direction(math.radians(elevation_deg), math.radians(azimuth_deg))
    return Sky(sun, sun_irradiance(math.radians(elevation_deg), turbidity), clear_sky(sun, turbidity))


def mitsuba_sky(mitsuba: Any, sun: Field, turbidity: float, rays: Field, **scales: float) -> Field:
    """Radiance [3, N] of Mitsuba's `sunsky`, whose zenith is +z."""
    plugin = mitsuba.load_dict(
        {"type": "sunsky", "turbidity": turbidity, "sun_direction": [float(sun[0]), float(-sun[2]), float(sun[1])],
         "albedo": 0.2, **scales}
    )  # fmt: skip
    interaction, values = mitsuba.SurfaceInteraction3f(), []
    for x, y, z in rays.T.tolist():
        interaction.wi = mitsuba.Vector3f(-x, z, -y)
        values.append(list(plugin.eval(interaction)))
    return np.array(values, np.float32).T


@pytest.mark.parametrize("elevation_deg", [15, 40, 65])
@pytest.mark.parametrize("turbidity", [2.0, 3.0, 6.0])
def test_clear_skies_are_like_mitsubas(mitsuba: Any, elevation_deg: float, turbidity: float) -> None:
    sky = clear(elevation_deg, turbidity=turbidity)
    rays = directions(32, 64)[:, :15].flatten(1).numpy()
    angles = solid_angles(32, 64)[:15].expand(-1, 64).flatten().numpy() * rays[1]
    ours, theirs = sky.radiance(rays), mitsuba_sky(mitsuba, sky.sun, turbidity, rays, sun_scale=0.0)
    shape = np.log(luminance(ours)), np.log(luminance(theirs))
    assert np.corrcoef(*shape)[0, 1] > 0.88
    assert np.abs(ours / ours.sum(0) - theirs / theirs.sum(0)).mean() < 0.06
    # Sunlight for the skylight, and their colours: the disc's radiance times its solid angle over the sky's irradiance.
    disc = math.tau * (1 - math.cos(math.radians(0.5358 / 2)))
    their_sun = disc * mitsuba_sky(mitsuba, sky.sun, turbidity, sky.sun[:, None], sky_scale=0.0)[:, 0]
    our_share, their_share = (
        luminance(sun / (light @ angles)) for sun, light in ((sky.sunlight, ours), (their_sun, theirs))
    )
    assert 0.5 < our_share / their_share < 1.6


def test_black_bodies_are_white_at_6500_kelvin_and_red_below() -> None:
    np.testing.assert_allclose(glowing(6500), 1, atol=0.06)
    reds = [float(glowing(kelvin)[0] / glowing(kelvin)[2]) for kelvin in (1800, 2700, 3999, 4001, 6000, 12000)]
    assert reds == sorted(reds, reverse=True)
    assert luminance(glowing(2700)) == pytest.approx(1, rel=0.01)


def test_the_sun_fades_to_the_horizon_and_in_haze() -> None:
    heights = [luminance(sun_irradiance(math.radians(angle), 3)) for angle in (-1, 0, 5, 20, 60)]
    assert heights == sorted(heights)
    assert heights[0] == 0
    assert luminance(sun_irradiance(1, 6)) < luminance(sun_irradiance(1, 2)) < 133
    low = sun_irradiance(0.1, 3)
    assert low[0] > 1.4 * low[2]


def test_clouds_take_the_sun_away_and_whiten_the_sky() -> None:
    sky, rays = clear(50), directions(32, 64)[:, :16].flatten(1).numpy()
    for seed in range(8):
        thin, thick = (cloudy(stream(seed), sky, cover) for cover in (-1.5, 2.5))
        np.testing.assert_allclose(thin.radiance(rays), sky.radiance(rays), rtol=1e-4)
        assert (thin.sunlight == sky.sunlight).all()
        assert (thick.sunlight < 0.4 * sky.sunlight).all()
        assert 0.4 < luminance(thick.radiance(rays)).mean() / luminance(sky.radiance(rays)).mean() < 4


@pytest.mark.parametrize("draw", [day_sky, overcast, night_sky])
def test_skies_are_finite_and_positive_everywhere(draw: Callable[..., Sky]) -> None:
    for seed in range(20):
        radiance = draw(stream(seed)).radiance(view(1)[0])
        assert radiance.dtype == np.float32
        assert np.isfinite(radiance).all()
        assert (radiance > 0).all()


@pytest.mark.parametrize("kind", ["hills", "woods", "town"])
def test_horizons_hide_the_sky_just_where_they_stand(kind: str) -> None:
    sky, rays = clear(30), view(1)[0]
    backdrop, flat = (skyline(stream(3), sky, WHITE, kind, height) for height in (0.3, 1e-4))
    seen, changed = backdrop.clearness(rays), (backdrop.radiance(rays) != flat.radiance(rays)).any(0)
    assert (changed == (seen != flat.clearness(rays))).mean() > 0.999
    assert seen[(rays[1] > 0) & (rays[1] < 0.2)].mean() < 0.95
    assert seen[rays[1] > 0.6].all()

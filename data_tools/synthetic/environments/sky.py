"""Skies and their suns: clear daylight, broken clouds, overcast, night.

Directions are [3, N], unit length, +y up. Radiance is linear Rec.709 with a luminance in kcd/m^2, irradiance in klx.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.environments.patterns import (
    BLACK,
    black_body_rgb,
    direction,
    look_up_noise,
    vector,
    xyy_to_rgb,
)
from data_tools.synthetic.patterns.fields import smoothstep
from data_tools.synthetic.random_values import Field, between, chance, log_between, pick

# Perez' coefficients A to E for luminance, in very clear air (turbidity 2) and from turbidity 5 on (the CIE's clear
# sky, type 12), and for the chromaticities x and y, as slope over turbidity and offset (Preetham, Shirley & Smits
# 1999).
_PEREZ_CLEAR, _PEREZ_HAZY = (-1.1056, -0.2833, 5.2797, -2.3359, 0.2363), (-1.0, -0.32, 10.0, -3.0, 0.45)
_PEREZ_COLOUR = {
    "x": ((-0.0193, -0.0665, -0.0004, -0.0641, -0.0033), (-0.2592, 0.0008, 0.2125, -0.8989, 0.0452)),
    "y": ((-0.0167, -0.0950, -0.0079, -0.0441, -0.0109), (-0.2608, 0.0092, 0.2102, -1.6537, 0.0529)),
}
# Chromaticity of the zenith, by these authors, too: rows are powers 2, 1, 0 of turbidity, columns powers 3 to 0 of the
# sun's zenith angle.
_ZENITH = {
    "x": (
        (0.00166, -0.00375, 0.00209, 0),
        (-0.02903, 0.06377, -0.03202, 0.00394),
        (0.11693, -0.21196, 0.06052, 0.25886),
    ),
    "y": (
        (0.00275, -0.00610, 0.00317, 0),
        (-0.04214, 0.08970, -0.04153, 0.00516),
        (0.15346, -0.26756, 0.06670, 0.26688),
    ),
}
# Shares that are taken of the published luminance of the zenith and extinction by aerosols: later models have more
# sunlight for their skylight.
_SKY_SHARE, _AEROSOL_SHARE = 0.5, 0.5
_SOLAR = 133.0 * np.array([1.02, 1.0, 0.96])  # irradiance outside the atmosphere, klx
_WAVELENGTHS_UM = np.array([0.605, 0.55, 0.465])  # about where the primaries' light comes from
_OZONE = np.array([0.035, 0.025, 0.003])  # optical depths


@dataclass(frozen=True)
class Sky:
    """A sky without its ground.

    Attributes:
        sun: direction of the sun's centre [3].
        sunlight: irradiance [3] in klx of the sun's disc on a surface that faces it, behind its clouds.
        radiance: function from directions [3, N] to kcd/m^2 [3, N], without the sun's disc; below the horizon it
            continues the horizon.
    """

    sun: Field
    sunlight: Field
    radiance: Callable[[Field], Field]


def angles_between(sun: Field, rays: Field) -> Field:
    """Return the angles [N] in rad between a direction [3] and others [3, N]."""
    return np.arccos(np.clip(sun @ rays, -1, 1))


def sun_irradiance(elevation_rad: float, turbidity: float) -> Field:
    """Return the irradiance [3] in klx of the sun on a surface that faces it.

    Rayleigh scattering, aerosols and ozone have dimmed it.
    """
    degrees = max(math.degrees(elevation_rad), 0.0)
    air_mass = 1 / (math.sin(math.radians(degrees)) + 0.15 * (degrees + 3.885) ** -1.253)  # Kasten 1966
    molecules = 0.008735 * _WAVELENGTHS_UM**-4.08
    aerosols = _AEROSOL_SHARE * (0.04608 * turbidity - 0.04586) * _WAVELENGTHS_UM**-1.3
    visible_share = min(1.0, max(0.0, elevation_rad / 0.0093 + 0.5))  # share of the disc above the horizon
    result: Field = (_SOLAR * visible_share * np.exp(-air_mass * (molecules + aerosols + _OZONE))).astype(np.float32)
    return result


def clear_sky(sun: Field, turbidity: float) -> Callable[[Field], Field]:
    """Return the radiance of the cloudless daylight sky as a function of direction.

    Args:
        sun: direction of the sun [3]; one below the horizon counts as on it.
        turbidity: 1.9 (very clear) to 10 (hazy).

    Returns:
        A function from directions [3, N] to radiance [3, N], kcd/m^2.
    """
    theta = min(math.acos(float(np.clip(sun[1], -1, 1))), math.radians(89))
    haze = min(max((turbidity - 2) / 3, 0.0), 1.0)
    perez = {"Y": tuple(c + (h - c) * haze for c, h in zip(_PEREZ_CLEAR, _PEREZ_HAZY, strict=True))}
    for name, (slope, offset) in _PEREZ_COLOUR.items():
        perez[name] = tuple(s * turbidity + o for s, o in zip(slope, offset, strict=True))
    chi = (4 / 9 - turbidity / 120) * (math.pi - 2 * theta)
    zenith_luminance = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    zenith = {"Y": _SKY_SHARE * max(zenith_luminance, 0.1)}
    powers = np.array([theta**3, theta**2, theta, 1])
    for name, table in _ZENITH.items():
        zenith[name] = float(np.array([turbidity**2, turbidity, 1]) @ np.array(table) @ powers)

    def radiance(rays: Field) -> Field:
        inverse = 1 / np.maximum(rays[1], np.float32(0.02))
        gamma, values = angles_between(sun, rays), {}
        nearness = np.cos(gamma)
        for name, (a, b, c, d, e) in perez.items():
            to_zenith = (1 + a * math.exp(b)) * (1 + c * math.exp(d * theta) + e * math.cos(theta) ** 2)
            shape = (1 + a * np.exp(b * inverse)) * (1 + c * np.exp(d * gamma) + e * nearness**2)
            values[name] = shape * (zenith[name] / to_zenith)
        return xyy_to_rgb(
            np.maximum(values["Y"], 1e-3), np.clip(values["x"], 0.2, 0.55), np.clip(values["y"], 0.2, 0.5)
        )

    return radiance


def day_sky(rng: Rng, elevation_rad: tuple[float, float] = (0.12, 1.25), clear_share: float = 0.45) -> Sky:
    """Draw a sky by day: clear, hazy or with broken clouds, the sun anywhere at an elevation from the range."""
    height = math.asin(between(rng, math.sin(elevation_rad[0]), math.sin(elevation_rad[1])))
    sun, turbidity = direction(height, between(rng, 0, math.tau)), log_between(rng, 1.9, 6.5)
    sunlight, clear_radiance = sun_irradiance(height, turbidity), clear_sky(sun, turbidity)
    glare, width = log_between(rng, 0.004, 0.08), log_between(rng, 0.03, 0.12)  # of the lens and haze; width in rad
    halo = sunlight * np.float32(glare / (math.tau * width**2))

    def radiance(rays: Field) -> Field:
        result: Field = clear_radiance(rays) + halo[:, None] * np.exp(
            angles_between(sun, rays) * np.float32(-1 / width)
        )
        return result

    sky = Sky(sun, sunlight, radiance)
    return sky if chance(rng, clear_share) else add_clouds(rng, sky, between(rng, 0.05, 0.75))


def add_clouds(rng: Rng, sky: Sky, cover: float) -> Sky:
    """Draw broken clouds before a sky, lit by its sun, which they may hide.

    Args:
        rng: random numbers for the clouds.
        sky: the sky behind them.
        cover: share of the sky that clouds hide, about.
    """
    low, soft = 1.3 - 3.2 * cover, between(rng, 0.7, 2)
    size, stretch, depth = log_between(rng, 3, 9), between(rng, 0.6, 1.7), log_between(rng, 0.8, 4)
    first, second, turn = float(rng.random()), float(rng.random()), between(rng, 0, math.tau)
    cos, sin = math.cos(turn), math.sin(turn)

    def density(across: Field, along: Field) -> Field:
        """Return how dense clouds are, 0 to 1, at coordinates [N] of the cloud layer."""
        u, v = (across * cos + along * sin) / size, (along * cos - across * sin) * (stretch / size)
        fine = look_up_noise("rough", 2.3 * u + second, 2.3 * v + first)
        return smoothstep(look_up_noise("cloud", u + first, v + second) + np.float32(0.35) * fine, low, low + soft)

    def layer_coordinates(rays: Field) -> tuple[Field, Field]:
        """Return where rays [3, N] meet the cloud layer, across and along it, each [N]."""
        height = np.maximum(rays[1], 0) + np.float32(0.09)  # the earth is round
        return rays[0] / height, rays[2] / height

    in_front = float(density(*layer_coordinates(sky.sun[:, None]))[0])
    ambient = sky.radiance(direction(0.9, turn)[:, None])
    shift = sky.sun[[0, 2]] * np.float32(0.02 * size / max(float(np.hypot(sky.sun[0], sky.sun[2])), 1e-3))

    def radiance(rays: Field) -> Field:
        across, along = layer_coordinates(rays)
        local_density, sunward_density = density(across, along), density(across + shift[0], along + shift[1])
        lit = np.exp(-0.8 * depth * np.maximum(sunward_density - 0.3 * local_density, 0))
        transmittance, gamma = np.exp(-0.5 * depth * local_density), angles_between(sky.sun, rays)
        phase = 0.12 + 0.08 * gamma + 0.5 * transmittance * np.exp(-4 * gamma)
        cloud = sky.sunlight[:, None] * (phase * (0.25 + 0.75 * lit) * (0.4 + 0.6 * transmittance))
        cloud += ambient * (0.55 + 0.45 * transmittance)
        nearness = np.exp(np.float32(-0.12) / np.maximum(rays[1], np.float32(0.01)))  # haze hides distant clouds
        clear = sky.radiance(rays)
        result: Field = clear + (cloud - clear) * ((1 - np.exp(-depth * local_density)) * nearness)
        return result

    return Sky(sky.sun, sky.sunlight * np.float32(math.exp(-1.5 * depth * in_front)), radiance)


def overcast_sky(rng: Rng) -> Sky:
    """Draw closed clouds or fog, without the sun's disc.

    They are brighter to the zenith (the CIE's overcast sky) or even, and brighter to the sun.
    """
    sun = direction(between(rng, 0.15, 1.1), between(rng, 0, math.tau))
    zenith = log_between(rng, 1.0, 12.0) * float(sun[1]) ** 0.8
    colour = black_body_rgb(log_between(rng, 5800, 8500))[:, None] * np.float32(zenith)
    grade, contrast = pick(rng, (2.0, 2.0, 1.0, 0.2)), between(rng, 0.0, 0.45)
    glow, width = (0.0 if chance(rng, 0.3) else log_between(rng, 0.3, 4.0)), between(rng, 0.2, 0.6)
    size, first, second = log_between(rng, 3, 10), float(rng.random()), float(rng.random())

    def radiance(rays: Field) -> Field:
        height = np.maximum(rays[1], 0)
        across, along = (rays[axis] / (height + np.float32(0.15)) / size for axis in (0, 2))
        clouds = look_up_noise("cloud", across + first, along + second) * (
            contrast * height / (height + np.float32(0.25))
        )
        level = (
            (1 + grade * height) / (1 + grade) * (1 + glow * np.exp(angles_between(sun, rays) * np.float32(-1 / width)))
        )
        result: Field = colour * (level * np.exp(clouds))
        return result

    return Sky(sun, BLACK, radiance)


def night_sky(rng: Rng) -> Sky:
    """Draw the sky over a town at night, brighter at the horizon."""
    town = black_body_rgb(log_between(rng, 2000, 5000))[:, None] * np.float32(log_between(rng, 1e-4, 4e-3))
    zenith = black_body_rgb(log_between(rng, 7000, 16000))[:, None] * np.float32(log_between(rng, 5e-5, 2e-3))

    def radiance(rays: Field) -> Field:
        result: Field = zenith + town * np.exp(np.float32(-5) * np.maximum(rays[1], 0))
        return result

    return Sky(vector(0, -1, 0), BLACK, radiance)


def black_sky() -> Sky:
    """Return a sky that sends no light, for rooms without windows."""
    return Sky(vector(0, -1, 0), BLACK, np.zeros_like)

"""Random photographs of augmented materials, for training: by a rig, under a dome of lights, by a phone, by hand."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.flash import camera_distance
from metapp.appearance.svbrdf_maps import unpack_maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_LOG_GAIN, FLASH_NUMBERS, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.multi_photo.handling import develop_photos, handle_photos
from metapp.apps.svbrdf_nonstationary.places import held_places
from metapp.apps.svbrdf_nonstationary.variants import Draw, draws_per_material

# Shares of materials by how they are photographed; the rest is taken by hand without what a phone does to photographs
RIG_SHARE = 0.22  # camera and flash together, at exact places, equal exposures
DOME_SHARE = 0.15  # the camera stands still above, lights are around it, at exact places
PHONE_SHARE = 0.55  # see :func:`handle_photos`
TILTED_SHARE = 0.6  # share of materials around which the camera is moved, tilted towards them; else it is held above
MAX_TILT_RAD = math.radians(36)  # largest angle of the direction to the camera with the patch's normal
MAX_PLACE_ERROR_FACTOR = 1.5  # largest errors of measured places, over the errors that `held_places` draws
PHONE_FLASH_OFFSET_HALF_SIDES = 0.05  # standard deviation of the flash of a phone from its lens, along x and y
DOME_ELEVATIONS_RAD = math.radians(25), math.radians(75)  # angles of lights with the material
DOME_DISTANCES, DOME_CAMERA_DISTANCES = (4.0, 20.0), (3.0, 20.0)  # of lights and camera, in half sides
UNEQUAL_EXPOSURE_SHARE = 0.3  # share of materials whose photographs differ in exposure
# Natural logs of exposures: mean and standard deviation where they differ, and standard deviation where they do not
UNEQUAL_EXPOSURE_LOG_MEAN, UNEQUAL_EXPOSURE_LOG_DEVIATION, EQUAL_EXPOSURE_LOG_DEVIATION = -0.15, 0.35, 0.06
DOME_LOG_EXPOSURE = 0.2  # largest natural log of the exposure under a dome, one for all photographs
MAX_DISPLAY_NOISE = 0.01  # largest standard deviation of the noise of a material's photographs, in display values
STEADY_NOISE_SHARE = 0.3  # of that noise where camera or flash are on a stand


def draw_photo_sets(maps: Tensor, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw random places of cameras and flashes, and exposures, and render photographs of materials.

    How photographs are taken is drawn for each material: by a rig, under a dome, by a phone or otherwise by hand. All
    have Gaussian noise in display values, whose standard deviation, too, is drawn for each material.

    Args:
        maps: packed maps [T, 10, S, S].
        count: photographs of each material.
        rng: draws all random numbers.

    Returns:
        Photographs [T, count, 3, S, S], linear values in [0, 1] that were rounded to 8 bits of sRGB, and measured
        positions of camera and flash, [T, count, 2, 3], in half sides of the patch.
    """
    uniform, normal = draws_per_material(len(maps), rng)
    kind = uniform(1, 1)
    is_rig, is_steady = kind < RIG_SHARE, kind < RIG_SHARE + DOME_SHARE
    is_dome, is_phone = is_steady & ~is_rig, ~is_steady & (kind < RIG_SHARE + DOME_SHARE + PHONE_SHARE)

    cameras, offsets = _draw_cameras(len(maps), count, rng)
    measured = cameras + ~is_steady * MAX_PLACE_ERROR_FACTOR * uniform(1, 1) * offsets
    beside_lens = PHONE_FLASH_OFFSET_HALF_SIDES * is_phone * (normal(1, 2) + 0.2 * normal(count, 2))
    flashes = cameras + torch.nn.functional.pad(beside_lens, (0, 1))
    dome, dome_log_exposure = _draw_dome(count, uniform, normal)
    positions, measured_positions = (
        torch.where(is_dome[..., None], dome, torch.stack(by_hand, 2))
        for by_hand in ((cameras, flashes), (measured, measured))
    )
    log_exposure = torch.where(
        uniform(1) < UNEQUAL_EXPOSURE_SHARE,
        UNEQUAL_EXPOSURE_LOG_DEVIATION * normal(count) + UNEQUAL_EXPOSURE_LOG_MEAN,
        EQUAL_EXPOSURE_LOG_DEVIATION * normal(count),
    )
    log_exposure = torch.where(is_rig[..., 0], 0, torch.where(is_dome[..., 0], dome_log_exposure, log_exposure))
    numbers = torch.nn.functional.pad(log_exposure[..., None] / FLASH_LOG_GAIN, (FLASH_NUMBERS - 1, 0))

    material = unpack_maps(maps)
    radiance = render_photos(material, decode_flash(numbers, positions, camera="held"))
    is_phone, is_steady = (chosen[..., None, None] for chosen in (is_phone, is_steady))
    radiance = torch.where(is_phone, handle_photos(radiance, material, cameras, rng), radiance)
    display = linear_to_srgb(radiance.clamp(0, 1))
    display = torch.where(is_phone, develop_photos(display, rng), display)
    noise_deviation = MAX_DISPLAY_NOISE * uniform(1, 1, 1, 1) * torch.where(is_steady, STEADY_NOISE_SHARE, 1.0)
    display = display + noise_deviation * torch.randn(display.shape, generator=rng, device=rng.device)
    return srgb_to_linear((display.clamp(0, 1) * 255).round() / 255), measured_positions


def _draw_cameras(materials: int, count: int, rng: Generator) -> tuple[Tensor, Tensor]:
    """Draw places of cameras, and errors of measured places, [T, count, 3] each, as people hold a camera.

    For a share of TILTED_SHARE of the materials the camera is moved around the patch and tilted towards it, except for
    the first photograph, which is taken from nearly straight above; else it is held above, see :func:`held_places`.
    """
    uniform, normal = draws_per_material(materials, rng)
    places_above, offsets = held_places(materials, count, rng)
    azimuth = 2 * math.pi * (torch.arange(count, device=rng.device)[None, :, None] / max(count - 1, 1) + uniform(1, 1))
    azimuth, tilt = azimuth + 0.4 * normal(count, 1), 0.1 + (MAX_TILT_RAD - 0.1) * uniform(count, 1)
    tilt = torch.cat([0.15 * tilt[:, :1], tilt[:, 1:]], 1)
    distance = camera_distance() * (0.75 + 0.5 * uniform(count, 1)) * (1 + uniform(1, 1))
    tilted_places = distance * torch.cat([tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos()], -1)
    return torch.where(uniform(1, 1) < TILTED_SHARE, tilted_places, places_above), offsets


def _draw_dome(count: int, uniform: Draw, normal: Draw) -> tuple[Tensor, Tensor]:
    """Draw a camera above and lights around it, [T, count, 2, 3], and logs of exposures, [T, count].

    All lights are as bright as each other: the exposures undo that a white patch right below each has radiance 1.
    """
    lowest, highest = DOME_ELEVATIONS_RAD
    elevation = lowest + (highest - lowest) * uniform(count, 1)
    steps = torch.arange(count, device=elevation.device)[None, :, None] / count
    azimuth = 2 * math.pi * (steps + uniform(1, 1)) + 0.3 * normal(count, 1)
    distance, height = (
        nearest + (farthest - nearest) * uniform(1, 1) for nearest, farthest in (DOME_DISTANCES, DOME_CAMERA_DISTANCES)
    )
    towards = torch.cat([elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()], -1)
    camera = torch.nn.functional.pad(height, (2, 0)).expand(-1, count, -1)
    log_exposure = DOME_LOG_EXPOSURE * (2 * uniform(1) - 1) - 2 * elevation[..., 0].sin().log()
    return torch.stack([camera, distance * towards], 2), log_exposure

"""Small example inputs, one or two files an application, drawn like the test tasks of the embedded sets.

They are in no embedded set; each is drawn in less than a second, and equal on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from data_tools.random_streams import random_stream
from data_tools.synthetic import brdf, cornell, illumination, svbrdf_nonstationary, svbrdf_stationary, texture
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.geometry import directions_to_full_rusinkiewicz
from metapp.appearance.latlong import texel_index
from metapp.storage.files import write_atomically, write_bytes
from metapp.storage.image_writers import write_exr, write_png

_SEED = 1  # of all draws; the embedded sets have seed 0
_PAIRS = 2000  # rows of the table of a BRDF
_ROWS = 128  # rows of the environment map
_LAMP = 0.5  # half of the sides of the box's lamp, a quarter of the ceiling
_SIDE, _BALL = 256, 110  # px, side of the ball's photo and radius of the ball in it


class Example(NamedTuple):
    """The example inputs of an application.

    Attributes:
        files: names of the files; fits take the first one without options.
        write: function that writes the files at the paths that are its arguments.
    """

    files: tuple[str, ...]
    write: Callable[..., None]


def write_example(app: str, folder: Path) -> list[Path]:
    """Write the example inputs of an application.

    Args:
        app: one of `EXAMPLES`.
        folder: made if missing; files of the same names are replaced.

    Returns:
        The files, in the order of `EXAMPLES`.

    Raises:
        ValueError: an application without examples.
        OSError: they cannot be written.
    """
    if app not in EXAMPLES:
        raise ValueError(f"{app}: no example inputs, expected one of {', '.join(EXAMPLES)}.")
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / name for name in EXAMPLES[app].files]
    EXAMPLES[app].write(*files)
    return files


def _write_brdf(file: Path) -> None:
    """Write a paint, measured at random pairs of directions, as a table."""
    paint = brdf.synthetic_materials("test", 4, _SEED)[3]
    rng = Generator().manual_seed(_SEED)
    wi, wo = (_map_to_hemisphere(torch.rand(2, _PAIRS, generator=rng)) for _ in range(2))
    angles_deg = [
        angle.rad2deg()
        for x, y, z in (wi.T.double(), wo.T.double())
        for angle in (torch.hypot(x, y).atan2(z), y.atan2(x))
    ]
    rows = torch.cat([torch.stack(angles_deg, 1), paint.evaluate(directions_to_full_rusinkiewicz(wi, wo))], 1)
    header = "# a row a pair of directions: theta_i, phi_i light, theta_o, phi_o detector; r, g, b its BRDF in 1/sr\n"
    header += "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,r,g,b"
    formats = ["%.2f"] * 4 + ["%.6g"] * 3
    write_atomically(file, lambda path: np.savetxt(path, rows, formats, ",", header=header, comments=""))


def _map_to_hemisphere(uniform: Tensor) -> Tensor:
    """Map numbers [2, N] in [0, 1) to unit vectors [N, 3], uniform to 89 degrees from the normal."""
    z, phi = 0.02 + 0.98 * uniform[0], 2 * torch.pi * uniform[1]
    across = (1 - z**2).sqrt()
    return torch.stack([across * phi.cos(), across * phi.sin(), z], 1)


def _write_texture(file: Path) -> None:
    """Write a picture of bricks."""
    _write_picture(_draw_picture(texture, "bricks", "image", 27), file)


def _write_svbrdf_stationary(file: Path) -> None:
    """Write a flash photo of leather with a coarse grain, whose relief shows under any light."""
    _write_picture(_draw_picture(svbrdf_stationary, "leather", "image", 40), file)


def _write_svbrdf_nonstationary(file: Path) -> None:
    """Write a flash photo of a mosaic."""
    _write_picture(_draw_picture(svbrdf_nonstationary, "mosaic", "photo", _SEED), file)


def _draw_picture(module: ModuleType, family: str, key: str, seed: int) -> Tensor:
    """Draw the first test task of a family in a seed's set, and return a picture of it, uint8 [3, 256, 256]."""
    tasks = module.synthetic_tasks("test", 20, seed, size=256)
    picture: Tensor = next(task.data[key] for task in tasks if task.name.startswith(family))
    return picture


def _write_illumination(map_file: Path, ball_file: Path) -> None:
    """Write a lobby's map, and a photo of a mirror ball in it as a phone shows it: the brightest px are clipped."""
    light = illumination.draw_environment_map(illumination.FAMILIES["lobby"], random_stream(_SEED, 1), rows=_ROWS)
    write_exr(light.permute(1, 2, 0), map_file)
    coordinates = (np.arange(2 * _SIDE) + 0.5) / 2 - _SIDE / 2
    disc = np.stack(np.meshgrid(coordinates / _BALL, -coordinates / _BALL))
    background = np.stack([*(disc * 0.3), np.full(disc.shape[1:], -1.0)])
    radius = np.hypot(*disc)
    psi = 2 * np.arcsin(radius.clip(max=1))  # rad, between view and reflection
    mirrored = np.stack([*(np.sin(psi) * (disc / radius)), np.cos(psi)])
    directions = np.where(radius < 1, mirrored, background / np.linalg.norm(background, axis=0))
    ball_radiance = _look_up_radiance(light, directions).unflatten(2, (_SIDE, 2)).unflatten(1, (_SIDE, 2)).mean((2, 4))
    exposed = ball_radiance * (0.4 / ball_radiance.mean())
    _write_picture(255 * linear_to_srgb(exposed.clamp(0, 1)), ball_file)


def _look_up_radiance(light: Tensor, directions: NDArray[np.floating]) -> Tensor:
    """Look up the radiance [3, H, W] of a map in directions [3, H, W]."""
    texels = texel_index(torch.from_numpy(directions), *light.shape[1:])
    return light.flatten(1)[:, texels]


def _write_transport(file: Path) -> None:
    """Write a Cornell box with a red and a blue wall, two matte balls and a wide lamp, which paths often hit."""
    scene: cornell.SceneEntry = {"type": "scene", "sensor": cornell.sensor_entry()}
    scene |= cornell.wall_entries([0.7, 0.12, 0.08], [0.1, 0.25, 0.7])
    lamp = cornell.rectangle_entry((0, 0.99, 0), (_LAMP, 0, 0), (0, 0, _LAMP), cornell.diffuse_bsdf([0.0] * 3))
    scene["light"] = {**lamp, "emitter": {"type": "area", "radiance": cornell.rgb_entry([4.4, 4.0, 3.6])}}
    for name, centre, radius, colour in (
        ("sphere-0", (-0.4, -0.62, -0.3), 0.38, [0.75, 0.6, 0.3]),
        ("sphere-1", (0.42, -0.7, 0.25), 0.3, [0.6, 0.35, 0.25]),
    ):
        scene[name] = cornell.sphere_entry(cornell.SpherePlace(centre, radius), cornell.diffuse_bsdf(colour))
    text = cornell.to_xml(scene)
    write_bytes(file, text.encode())


def _write_picture(values: Tensor, file: Path) -> None:
    """Write a picture of sRGB values [3, H, W], 0 .. 255."""
    write_png(values.permute(1, 2, 0) / 255, {"encoding": "sRGB"}, file)


EXAMPLES: Mapping[str, Example] = {
    "brdf": Example(("paint.csv",), _write_brdf),
    "texture": Example(("bricks.png",), _write_texture),
    "svbrdf_stationary": Example(("leather.png",), _write_svbrdf_stationary),
    "svbrdf_nonstationary": Example(("mosaic.png",), _write_svbrdf_nonstationary),
    "illumination": Example(("lobby.exr", "ball.png"), _write_illumination),
    "transport": Example(("box.xml",), _write_transport),
}

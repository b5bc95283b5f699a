"""Photographs of glossy black balls on a textured plane with relief, under lamps in known places, in closed form."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from data_tools.readers.colours import Floats
from tests.extensions.capture.ball_photos import write_linear_png

SAMPLES = 3  # along a side of a pixel


def dome(count: int, low: float = 25.0, high: float = 75.0) -> Floats:
    """Return directions to lamps [count, 3] on a spiral, at elevations between two angles in degrees."""
    elevation = np.radians(np.linspace(high, low, count))
    turn = 2.4 * np.arange(count)
    return np.stack([np.cos(elevation) * np.cos(turn), np.cos(elevation) * np.sin(turn), np.sin(elevation)], 1)


class Scene(NamedTuple):
    """What is photographed; lengths in px, places from the upper left corner.

    Attributes:
        balls: x, y and radius of each ball, which lies on the plane.
        width, height: the size of the photographs.
        lamp_degrees: half the angle that a lamp fills.
        radiance: the radiance of lamps; the plane's is below 1.
        noise: the standard deviation of noise.
        window: the radiance of a window that balls mirror in all photographs.
        relief: the slope of the plane's relief.
        body: the albedo of the balls.
    """

    balls: Sequence[tuple[float, float, float]]
    width: int = 200
    height: int = 140
    lamp_degrees: float = 4.0
    radiance: float = 60.0
    noise: float = 0.003
    window: float = 0.0
    relief: float = 0.4
    body: float = 0.01

    def photograph(self, lamp: Floats, seed: int = 0) -> Floats:
        """Return a photograph in linear RGB, [3, height, width].

        Args:
            lamp: the direction to a lamp far away, [3], or if it is longer than 2 its place from the middle of the
                plane, in px: x right, y up, z to the camera; zeros if it is hidden.
            seed: the seed of the noise.
        """
        columns, rows = ((np.arange(SAMPLES * side) + 0.5) / SAMPLES for side in (self.width, self.height))
        x, y = np.meshgrid(columns - self.width / 2, self.height / 2 - rows)
        place = np.stack([x, y, np.zeros_like(x)])
        light, towards = self._plane(place, lamp), self._towards(place, lamp)
        for ball in self.balls:
            centre = self._centre(ball)
            across = centre[:, None, None] - place
            along = (across * towards).sum(0)
            light = np.where(((across**2).sum(0) - along**2 < ball[2] ** 2) & (along > 0), 0.15 * light, light)
        for ball in self.balls:
            offset = (place[:2] - self._centre(ball)[:2, None, None]) / ball[2]
            light = np.where(np.hypot(*offset) < 1, self._ball(ball, offset, lamp), light)
        picture = light.reshape(self.height, SAMPLES, self.width, SAMPLES).mean((1, 3))
        noisy = picture + self.noise * np.random.default_rng(seed).standard_normal((3, *picture.shape))
        return noisy.clip(0, 1)

    def write(self, folder: Path, lamps: Floats) -> list[Path]:
        """Write a photograph under each lamp, named by its number."""
        return [
            write_linear_png(folder / f"{number:02}.png", self.photograph(lamp, number))
            for number, lamp in enumerate(lamps)
        ]

    def _centre(self, ball: Sequence[float]) -> Floats:
        return np.array([ball[0] - self.width / 2, self.height / 2 - ball[1], ball[2]])

    def _towards(self, place: Floats, lamp: Floats) -> Floats:
        length = np.linalg.norm(lamp)
        vectors = np.broadcast_to(lamp[:, None, None], place.shape) - (place if length > 2 else 0)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=0), 1e-9)

    def _plane(self, place: Floats, lamp: Floats) -> Floats:
        rng = np.random.default_rng(1)
        shape = (self.height, self.width)
        albedo, relief = (gaussian_filter(rng.standard_normal(shape), sigma) for sigma in (1.5, 6.0))
        albedo = 0.5 + 0.12 * np.tanh(albedo / albedo.std())
        slopes = np.gradient(relief)
        slopes = [self.relief * slope / np.std(slope) for slope in slopes]
        albedo, down, right = (np.kron(plane, np.ones((SAMPLES, SAMPLES))) for plane in (albedo, *slopes))
        normals = np.stack([-right, down, np.ones_like(down)])
        normals /= np.linalg.norm(normals, axis=0)
        return albedo * (normals * self._towards(place, lamp)).sum(0).clip(0) + 0.02

    def _ball(self, ball: Sequence[float], offset: Floats, lamp: Floats) -> Floats:
        z = np.sqrt((1 - (offset**2).sum(0)).clip(0))
        normals = np.stack([*offset, z])
        mirrored = 2 * z * normals - np.array([0.0, 0.0, 1.0])[:, None, None]
        towards = self._towards(self._centre(ball)[:, None, None] + ball[2] * normals, lamp)
        table = 0.5 * towards[2].clip(0) + 0.02
        edge = np.radians(0.5)
        angles = np.arccos((mirrored * towards).sum(0).clip(-1, 1))
        disc = ((np.radians(self.lamp_degrees) - angles) / edge + 0.5).clip(0, 1) * (towards[2] > 0)
        window = self.window * (np.abs(mirrored - np.array([-0.4, 0.5, 0.77])[:, None, None]).max(0) < 0.15)
        light = np.where(mirrored[2] < 0, table, window + self.radiance * disc)
        fresnel = 0.04 + 0.96 * (1 - z) ** 5
        return fresnel * light + self.body * (normals * towards).sum(0).clip(0) + 0.004


def angles_between(first: Floats, second: Floats) -> Floats:
    """Return the angles between directions [N, 3], in degrees."""
    cosines = (first * second).sum(1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    return np.degrees(np.arccos(cosines.clip(-1, 1)))

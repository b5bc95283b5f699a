"""Photographs of one ball without further settings, as tasks of illumination."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.image_files import Pixels
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.latlong import sphere_normals
from metapp.apps.illumination.mirror import CLIPPED
from metapp.extensions.capture.ball.circle import score_of
from metapp.extensions.capture.ball.mirror import is_mirror
from metapp.extensions.capture.ball.shots import FOUND, Shot, disc, gray_of, lens_of, searched, shot_of
from metapp.extensions.capture.ball.unwrap import unwrapped
from metapp.extensions.capture.ball.view import Ball, Lens, mirrored
from metapp.learning.task import Task

SIZE = 64  # px of the photograph of the ball alone

_BETTER = 1.2  # of its score, that another ball must have
_SAME = 0.03  # of the radius, by which a ball may miss the central square's circle and be taken for that


def with_ball(pixels: Pixels, task: Task, size: int, fov_rad: float) -> Task:
    """The task of a photograph as its central square shows it, with what the ball in it tells.

    Args:
        pixels: the whole photograph.
        task: of that square.
        size: rows of a map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.
    """
    if pixels.values.shape[-1] != 3:  # what is transparent is no contour
        return task
    ball = _found(pixels, lens_of(pixels, fov_rad))
    shot = shot_of(pixels, ball or _central(pixels))
    mirror = is_mirror(shot)
    if ball:
        task = Task(task.name, {"photos": photo_of(shot, mirror)[None]})
    return with_light(task, shot, size) if mirror else task


def _found(pixels: Pixels, lens: Lens | None) -> Ball | None:
    """The ball in a photograph; None where the central square's is as good."""
    ball = searched(pixels, lens)
    central = _central(pixels)
    if ball is None or ball.score < FOUND or ball.score < _BETTER * score_of(gray_of(pixels), central):
        return None
    away = math.hypot(ball.x - central.x, ball.y - central.y)
    differs = max(away, abs(ball.radius - central.radius), central.radius * math.hypot(*ball.slant))
    return ball if differs > _SAME * central.radius else None


def _central(pixels: Pixels) -> Ball:
    """The ball that touches the borders of the central square."""
    height, width = pixels.values.shape[:2]
    side = min(height, width)
    left, top = (width - side) // 2, (height - side) // 2
    return Ball(left + side / 2, top + side / 2, side / 2)


def with_light(task: Task, shot: Shot, rows: int) -> Task:
    """The task with what a mirror shows of the map."""
    size = min(800, 2 * math.ceil(shot.ball.radius))
    places = disc(size)
    light, there = shot.at(mirrored(places, shot.ball.angle))
    on_ball = there & (np.hypot(*places) < 1)
    clipped = (linear_to_srgb(torch.from_numpy(light)).numpy().max(0) >= CLIPPED) & on_ball
    seen, certain = unwrapped(light, clipped, on_ball, rows, shot.ball.angle, shot.ball.radius)
    return task._replace(data=task.data | {"seen": seen, "certain": certain})


def photo_of(shot: Shot, is_mirror: bool = True) -> Tensor:
    """A ball alone as a camera far away sees it, display values uint8 [3, SIZE, SIZE], black outside.

    Args:
        shot: the photograph.
        is_mirror: it is undone where the ball mirrors; else only its contour is made a circle.
    """
    many = max(1, math.ceil(2 * shot.ball.radius / SIZE))
    places = disc(SIZE * many)
    if is_mirror:
        light, _ = shot.at(mirrored(places))
    else:
        light, _ = shot._replace(turn=(0.0, 0.0, 0.0)).at(mirrored(places, shot.ball.angle))
    mean = torch.from_numpy(light.reshape(3, SIZE, many, SIZE, many).mean((2, 4)))
    return (linear_to_srgb(mean) * sphere_normals(SIZE)[1] * 255).round().to(torch.uint8)

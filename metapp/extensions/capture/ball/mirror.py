"""Classification of the ball of a single photograph: a mirror or not.

A mirror shows edges as sharp as the photograph, all over, and things that are dark; a ball with a body of its own or
a rough one shows neither. A logistic regression on three numbers, its weights made for simulated balls under synthetic
maps, says which.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.shots import Shot, disc, light_of
from metapp.extensions.capture.ball.view import Floats

SIZE = 128  # px that a ball is looked at
LEAST_PX = 40  # radius of a ball that can be told

_WITHIN = 0.92  # of the radius: the contour itself is sharp, whatever the ball
WEIGHTS = (1.379, 2.596, 4.226)
BIAS = -7.225


def is_mirror(shot: Shot) -> bool:
    """True if a ball is surely a mirror; False where it cannot be told."""
    if shot.ball.radius < LEAST_PX:
        return False
    return float(np.dot(WEIGHTS, features(light_of(shot, SIZE, shot.ball.angle)))) + BIAS > 0


def features(light: Floats) -> Floats:
    """Three numbers about a ball, linear RGB [3, SIZE, SIZE]; each grows with how much of a mirror it is.

    The logarithms of: how much of it has steep gradients; how much steeper these are when less smoothed; how dark it
    gets beside what a diffuse ball of the same mean would send out there.
    """
    inside = np.hypot(*disc(SIZE)) < _WITHIN
    linear = light.mean(0)
    display = linear_to_srgb(torch.from_numpy(linear.clip(0, 1))).numpy().astype(np.float64)
    fine, coarse = (_steepness(display, sigma)[inside] for sigma in (1.0, 3.0))
    spread = np.quantile(display[inside], 0.98) - np.quantile(display[inside], 0.02) + 0.02
    steep = (fine > 0.06 * spread).mean()
    ratio = (fine**2).mean() / max((coarse**2).mean(), 1e-9)
    weight = gaussian_filter(inside * 1.0, SIZE / 6)
    around = gaussian_filter(linear * inside, SIZE / 6) / np.maximum(weight, 1e-3)
    lit = gaussian_filter(linear, 1.0)
    dark = np.quantile((lit / np.maximum(around, 1e-4))[inside], 0.05)
    return np.array([math.log(steep + 0.003), math.log(ratio + 1e-3), -math.log(dark + 0.02)])


def _steepness(picture: Floats, sigma: float) -> Floats:
    y, x = np.gradient(gaussian_filter(picture, sigma))
    result: Floats = np.hypot(x, y)
    return result

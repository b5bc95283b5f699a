"""Whether reflectance can be that of a material: a wrong unit or a damaged table fits as well as a right one."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from metapp.learning.task import Task

HIGHEST = 1e6  # 1/sr; a GGX highlight of alpha 0.001 has 3e5, and published networks reach 4e5 beside the horizon
REFLECTED = 2.0  # of the light that comes in; of 131 published networks the brightest has 1.1
_RINGS, _TURNS = 256, 16


def warn_implausible(source: Path, task: Task, evaluate: Callable[[Tensor], Tensor]) -> None:
    """One warning where no material reflects so: nothing, far too bright, or more than comes in.

    Args:
        source: named in the warning.
        task: of a BRDF, with its samples.
        evaluate: reflectance [..., 3] in 1/sr of angles [..., 3] rad.
    """
    reflectance = task.data["reflectance"]
    high = float(reflectance.max())
    albedo = float(normal_albedo(evaluate).max())
    if high == 0:
        found, expected = "reflectance 0 everywhere", "some light reflected"
    elif high > HIGHEST:
        found, expected = f"reflectance of up to {high:.3g} /sr", f"at most {HIGHEST:g}"
    elif albedo > REFLECTED:
        found, expected = f"{albedo:.3g} times the light that comes in from above is reflected", "at most all of it"
    else:
        return
    warnings.warn(f"{source}: {found}, expected {expected}; is it damaged, or in another unit?", stacklevel=2)


def normal_albedo(evaluate: Callable[[Tensor], Tensor]) -> Tensor:
    """The share of light from straight above that is reflected, linear RGB [3].

    The half vector is in the middle, so theta_h = theta_d = theta_o / 2.
    """
    theta = (torch.arange(_RINGS) + 0.5) / _RINGS * (math.pi / 2)
    phi = (torch.arange(_TURNS) + 0.5) / _TURNS * math.pi
    half = (theta / 2)[:, None].expand(-1, _TURNS)
    with torch.no_grad():
        values = evaluate(torch.stack([half, half, phi.expand(_RINGS, -1)], -1)).double().mean(1)
    solid_angle = 2 * math.pi * theta.sin() * (math.pi / 2 / _RINGS)
    return (values * (solid_angle * theta.cos())[:, None]).sum(0)

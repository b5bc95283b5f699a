"""An anisotropic material for tests, and a network that was solved for it."""

import functools
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers.brdf_task import make_brdf_task
from data_tools.readers.measured_pairs import MeasuredPairs
from data_tools.synthetic.brdf_anisotropic import rotate_model
from data_tools.synthetic.brdf_anisotropic_models import Roughness, facets
from metapp.appearance.geometry import directions_to_four_angles, is_above_horizon, rusinkiewicz_to_directions
from metapp.apps.brdf.anisotropic import find_axes
from metapp.apps.brdf.recipes import ANISOTROPIC
from metapp.extensions.viewer.pages.anisotropic_residual import interpolation_matrix
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task

TURN = 0.7  # rad, azimuth of the axis along which the highlight reaches farthest
ROUGHNESS = Roughness(0.4, 0.12)
APP = ANISOTROPIC.meta["ridge"].app
VIEWERS = ((10, 0), (40, 70), (40, 200), (65, 310))  # degrees: theta, phi
COLOUR = (0.9, 0.6, 0.3)


def brushed_directions(wi: Tensor, wo: Tensor) -> Tensor:
    """GGX of two roughnesses, turned, on a diffuse body: [..., 3] in 1/sr of unit vectors above the surface."""
    lobe = rotate_model(facets(ROUGHNESS, lambda cos: cos * 0 + cos.new_tensor(COLOUR)), TURN)
    return lobe(wi, wo) + wi.new_tensor([0.02, 0.03, 0.05])


def brushed(angles: Tensor) -> Tensor:
    """The same of angles [..., 4] in rad, 0 below the horizon."""
    wi, wo = rusinkiewicz_to_directions(angles.double())
    return torch.where(is_above_horizon(angles)[..., None], brushed_directions(wi, wo), 0.0).to(angles)


def direction(theta: Any, phi: Any) -> NDArray[np.float64]:
    """Unit vectors [..., 3] of angles in rad."""
    parts = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(parts, -1).astype(np.float64)


def directions(count: int, seed: int, least: float = 0.05) -> Tensor:
    """Unit vectors above the surface, float64; the smaller `least`, the more of them are along it."""
    vectors = torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    vectors[:, 2] = vectors[:, 2].abs() + least
    return vectors / vectors.norm(dim=1, keepdim=True)


def viewer_at(degrees: tuple[float, float]) -> list[float]:
    """The direction of a viewer at angles (theta, phi)."""
    at: list[float] = direction(*np.radians(degrees)).tolist()
    return at


def measured(count: int, *, anisotropic: bool = True) -> MeasuredPairs:
    """The material, or one without azimuth, as a goniometer has it, with noise of 5 %."""
    wi, wo = directions(count, 3), directions(count, 4)
    near = wi * torch.tensor([-1.0, -1.0, 1.0]) + 0.4 * directions(count, 5)
    wo[::2] = (near / near.norm(dim=1, keepdim=True))[::2]
    values = brushed_directions(wi, wo)
    if not anisotropic:
        angles = directions_to_four_angles(wi, wo)
        angles[:, 3] = 0
        values = brushed(angles)
    noise = torch.exp(0.05 * torch.randn(values.shape, generator=torch.Generator().manual_seed(0)))
    return MeasuredPairs(wi, wo, values * noise)


@functools.cache
def task(samples: int = 16_384) -> Task:
    """The material as a task."""
    return make_brdf_task("brushed", brushed, samples, azimuths=True)


@functools.cache
def fitted() -> Params:
    """A network with random features, of which the last layer was solved for the material; without a task axis."""
    tasks = stack_tasks(APP, [task()])
    theta = APP.init(torch.Generator().manual_seed(0), 1)
    batch = APP.sample(tasks, torch.Generator().manual_seed(1), 4096)
    theta["turn"] = find_axes(batch)
    features = APP.network.linear_features(theta, batch["where"]).double()
    cos = batch["where"][:, 6:7]
    target = torch.log1p(torch.expm1(batch["target"]) / cos.clamp_min(0.05)).double()
    gram = features @ features.mT + 0.1 * torch.eye(features.shape[1], dtype=torch.float64)
    theta["last"] = torch.linalg.solve(gram, features @ target.mT).mT.float()
    return {key: value[0].detach() for key, value in theta.items()}


def interpolated(grid: Tensor, angles: Tensor, turn: float) -> Tensor:
    """The values that the page's shader finds at angles [N, 4] in rad in a grid of `anisotropic_residual`."""
    return torch.from_numpy(interpolation_matrix(angles, turn) @ grid.float().flatten(0, -2)[:, :3].numpy())

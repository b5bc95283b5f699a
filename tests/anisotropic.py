"""An anisotropic material in closed form, brushed metal, with tasks, measurements and a network of it for tests."""

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

HIGHLIGHT_AZIMUTH_RAD = 0.7  # of the axis along which the highlight is longest
ROUGHNESSES = Roughness(0.4, 0.12)
APP = ANISOTROPIC.meta["ridge"].app
VIEWERS_DEGREES = ((10, 0), (40, 70), (40, 200), (65, 310))  # theta and phi
COLOUR = (0.9, 0.6, 0.3)


def brushed_reflectance(wi: Tensor, wo: Tensor) -> Tensor:
    """Return the BRDF [..., 3] in 1/sr for unit vectors above the surface: an anisotropic GGX lobe and a constant."""
    lobe = rotate_model(facets(ROUGHNESSES, lambda cos: cos * 0 + cos.new_tensor(COLOUR)), HIGHLIGHT_AZIMUTH_RAD)
    return lobe(wi, wo) + wi.new_tensor([0.02, 0.03, 0.05])


def brushed_reflectance_at_angles(angles: Tensor) -> Tensor:
    """Return the BRDF [..., 3] in 1/sr for Rusinkiewicz angles [..., 4] in rad, 0 below the horizon."""
    wi, wo = rusinkiewicz_to_directions(angles.double())
    return torch.where(is_above_horizon(angles)[..., None], brushed_reflectance(wi, wo), 0.0).to(angles)


def direction_at_angles(theta: Any, phi: Any) -> NDArray[np.float64]:
    """Return unit vectors [..., 3] for spherical angles in rad."""
    parts = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    return np.stack(parts, -1).astype(np.float64)


def random_directions(count: int, seed: int, least_height: float = 0.05) -> Tensor:
    """Draw unit vectors above the surface, float64 [count, 3]; a smaller `least_height` gives more grazing ones."""
    vectors = torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    vectors[:, 2] = vectors[:, 2].abs() + least_height
    return vectors / vectors.norm(dim=1, keepdim=True)


def direction_at_degrees(degrees: tuple[float, float]) -> list[float]:
    """Return the unit vector [3] for (theta, phi) in degrees."""
    vector: list[float] = direction_at_angles(*np.radians(degrees)).tolist()
    return vector


def measure_with_noise(count: int, *, anisotropic: bool = True) -> MeasuredPairs:
    """Return measurements with noise of 5 %, half near the mirror direction, of the material or of an isotropic one."""
    wi, wo = random_directions(count, 3), random_directions(count, 4)
    near_mirror = wi * torch.tensor([-1.0, -1.0, 1.0]) + 0.4 * random_directions(count, 5)
    wo[::2] = (near_mirror / near_mirror.norm(dim=1, keepdim=True))[::2]
    values = brushed_reflectance(wi, wo)
    if not anisotropic:
        angles = directions_to_four_angles(wi, wo)
        angles[:, 3] = 0
        values = brushed_reflectance_at_angles(angles)
    noise = torch.exp(0.05 * torch.randn(values.shape, generator=torch.Generator().manual_seed(0)))
    return MeasuredPairs(wi, wo, values * noise)


@functools.cache
def brushed_task(samples: int = 16_384) -> Task:
    """Return the material as a task."""
    return make_brdf_task("brushed", brushed_reflectance_at_angles, samples, azimuths=True)


@functools.cache
def solve_for_brushed() -> Params:
    """Return parameters of a network with random features whose last layer is solved for the material; no task axis."""
    tasks = stack_tasks(APP, [brushed_task()])
    theta = APP.init(torch.Generator().manual_seed(0), 1)
    batch = APP.sample(tasks, torch.Generator().manual_seed(1), 4096)
    theta["axes_azimuth_rad"] = find_axes(batch)
    features = APP.network.linear_features(theta, batch["where"]).double()
    cos = batch["where"][:, 6:7]
    target = torch.log1p(torch.expm1(batch["target"]) / cos.clamp_min(0.05)).double()
    gram = features @ features.mT + 0.1 * torch.eye(features.shape[1], dtype=torch.float64)
    theta["last"] = torch.linalg.solve(gram, features @ target.mT).mT.float()
    return {key: value[0].detach() for key, value in theta.items()}


def interpolate_as_shader(grid: Tensor, angles: Tensor, turn: float) -> Tensor:
    """Return the values that the page's shader interpolates in a residual grid at angles [N, 4] in rad."""
    return torch.from_numpy(interpolation_matrix(angles, turn) @ grid.float().flatten(0, -2)[:, :3].numpy())

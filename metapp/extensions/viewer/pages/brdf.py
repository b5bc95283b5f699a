"""The view of a BRDF: its network as a texture, lobes to sample it by, its samples.

The page's shader evaluates the network and adds the residual of the samples, so that fit and reference can be rendered
side by side. The layouts that are packed here are read in `scripts/brdf.js`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import torch
from torch import Tensor

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.lobes import fit_lobes
from metapp.appearance.sphere import environment_scene, shade_sphere, studio_lights
from metapp.apps.brdf import anisotropic, feature_network
from metapp.apps.brdf.brdf_network import find_network
from metapp.extensions.viewer.pages import anisotropic_residual
from metapp.extensions.viewer.view import View, crop_thumbnail, reference_light_map
from metapp.learning.task import Task
from metapp.runs.fit import Fit

SAMPLE_GRID_CELLS = (48, 24, 48)  # along phi_d in [0, 2 pi), theta_d, and the square root of theta_h
WIDENING_ROUNDS = 4  # in each of which cells without samples take values from one cell farther
MAX_PLOTTED_SAMPLES = 8192  # of plots


def make_reflectance_page(fit: Fit) -> View:
    """Make the view of a fitted BRDF.

    It shows the fit, the samples if the task has some, and a reference if the material is known for all directions.

    Args:
        fit: the fit, whose task has no data if they are not at hand.
    """
    task, evaluate = fit.task, fit.asset.evaluate
    folded = find_network(fit.parameters).fold(fit.parameters)
    lobes = fit_lobes(evaluate, folded.axes_azimuth_rad)
    arrays = {"weights": pack_layers(folded.layers), "shares": torch.from_numpy(lobes.shares).float()}
    if "angles" in task.data:
        columns = [task.data["angles"], *([task.data["phi_h"][:, None]] if "phi_h" in task.data else [])]
        arrays["samples"] = torch.cat([*columns, task.data["reflectance"]], 1)[:MAX_PLOTTED_SAMPLES].half()
    if "render" in task.data:  # else the material is known at the samples alone, and not between them
        arrays["residual"] = _fit_residual(evaluate, folded.axes_azimuth_rad, task)
    facts = {
        "network": folded.inputs,
        "inputs": folded.layers[0][0].shape[1],
        "hidden": len(folded.layers[0][1]),
        "smoothing": [
            feature_network.AZIMUTH_ONSET_RAD2,
            feature_network.VECTOR_SMOOTHING,
            feature_network.COSINE_SMOOTHING,
        ],
        "turn": folded.axes_azimuth_rad,
        "darkest": folded.log_floor,
        "alphas": [list(alpha) for alpha in lobes.alphas],
    }
    sphere = shade_sphere(environment_scene(azimuths=folded.axes_azimuth_rad is not None), evaluate)
    thumbnail = crop_thumbnail(torch.from_numpy(composite_to_srgb(sphere[..., :3])))
    return View("brdf", arrays, {}, facts, {"studio": studio_lights(), "light": reference_light_map()}, thumbnail)


def pack_layers(layers: list[tuple[Tensor, Tensor]]) -> Tensor:
    """Pack three layers into one list of texels, [N, 4] float32; sizes are rounded up to multiples of four.

    The list holds for every four neurons of the first layer their weights, neuron by neuron, and their biases; then for
    every neuron of the second layer its weights, its factors in the three outputs, and its bias; at last the biases of
    the outputs.
    """
    (w1, b1), (w2, b2), (w3, b3) = (
        (_pad_to_fours(weights), _pad_to_fours(bias[:, None])[:, 0]) for weights, bias in layers
    )
    first_layer = torch.cat([w1.reshape(-1, 4 * w1.shape[1]), b1.reshape(-1, 4)], 1)
    second_layer = torch.cat([w2, w3[:3].T, b2[:, None]], 1)
    return torch.cat([part.reshape(-1, 4) for part in (first_layer, second_layer, b3)])


def _pad_to_fours(weights: Tensor) -> Tensor:
    """Return weights [out, in] as float32, with zeros up to multiples of four."""
    rows, columns = (-size % 4 for size in weights.shape)
    return torch.nn.functional.pad(weights.float(), (0, columns, 0, rows))


def _fit_residual(evaluate: Callable[[Tensor], Tensor], axes_azimuth_rad: float | None, task: Task) -> Tensor:
    """Return the difference of log(1 + f) of samples and fit, on a grid.

    The grid has phi_h as a coordinate if the samples or the fit depend on it.

    Args:
        evaluate: reflectance of the fit at angles.
        axes_azimuth_rad: azimuth of the material's axes; None if the fit is isotropic.
        task: the task, with `angles` [N, 3], `reflectance` [N, 3] and maybe `phi_h` [N].
    """
    columns, values = task.data["angles"].float().split(1, 1), torch.log1p(task.data["reflectance"].float())
    columns = (*columns[:2], columns[2] % math.pi)
    if "phi_h" in task.data or axes_azimuth_rad is not None:
        phi_h = task.data.get("phi_h", anisotropic.fixed_azimuths(len(values)))
        angles = torch.cat([*columns, phi_h.float()[:, None]], 1)[: anisotropic_residual.MAX_RESIDUAL_SAMPLES]
        residuals = values[: len(angles)] - torch.log1p(evaluate(angles))
        return anisotropic_residual.fit_residual_grid(angles, residuals, axes_azimuth_rad or 0.0)
    angles = torch.cat(columns, 1)
    exchanged = angles + angles.new_tensor([0, 0, math.pi])  # samples are reciprocal, but a fit need not be
    angles, values = torch.cat([angles, exchanged]), torch.cat([values, values])
    grid = grid_samples(angles, values - torch.log1p(evaluate(angles)))
    first_half, second_half = grid.float().chunk(2)
    return grid[: len(first_half)] if torch.allclose(first_half, second_half, atol=1e-3) else grid


def grid_samples(angles: Tensor, values: Tensor) -> Tensor:
    """Average values at samples on a grid.

    Each value counts in the cells around it by its distance along each axis; cells without samples take values from
    cells near them.

    Args:
        angles: theta_h, theta_d and phi_d of the samples, [N, 3] in rad, phi_d in [0, 2 pi).
        values: values of three channels at the samples, [N, 3].

    Returns:
        The grid, [*SAMPLE_GRID_CELLS, 4], float16; the fourth channel is 0, since textures have four.
    """
    shares = angles / angles.new_tensor([math.pi / 2, math.pi / 2, math.tau])
    places = (
        torch.stack([shares[:, 2], shares[:, 1], shares[:, 0].sqrt()], 1) * shares.new_tensor(SAMPLE_GRID_CELLS) - 0.5
    )
    first_cells, sums = places.floor(), torch.zeros(math.prod(SAMPLE_GRID_CELLS), 4)
    for corner in itertools.product((0, 1), repeat=3):
        cell = first_cells + first_cells.new_tensor(corner)
        weight = (1 - (places - cell).abs()).prod(1, keepdim=True)
        phi, theta_d, theta_h = cell.long().unbind(1)
        index = phi % SAMPLE_GRID_CELLS[0] * SAMPLE_GRID_CELLS[1] + theta_d.clamp(0, SAMPLE_GRID_CELLS[1] - 1)
        index = index * SAMPLE_GRID_CELLS[2] + theta_h.clamp(0, SAMPLE_GRID_CELLS[2] - 1)
        sums.index_add_(0, index, weight * torch.cat([values, torch.ones_like(values[:, :1])], 1))
    widened = sums.T.reshape(1, 4, *SAMPLE_GRID_CELLS)
    total = widened.clone()
    for step in range(1, WIDENING_ROUNDS + 1):
        padded = torch.nn.functional.pad(widened, (0, 0, 0, 0, 1, 1), mode="circular")
        padded = torch.nn.functional.pad(padded, (1, 1, 1, 1, 0, 0), mode="replicate")
        widened = torch.nn.functional.avg_pool3d(padded, 3, stride=1)
        total += 0.01**step * widened
    mean = total[0, :3] / total[0, 3:].clamp_min(1e-30)
    return torch.nn.functional.pad(mean.permute(1, 2, 3, 0), (0, 1)).half()

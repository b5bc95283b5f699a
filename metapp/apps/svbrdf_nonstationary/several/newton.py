"""Gauss-Newton steps of several photographs: the part `newton` of rules.

Given the flashes, texels are independent, as points are given the cameras in bundle adjustment (Triggs et al. 2000). So
a Schur complement yields one system of 4 N numbers for N flashes; then each texel has a system of 9 numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.flash import Maps, render_maps, texel_positions
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, CLIPPED_VALUE, FLASH_NUMBERS, ROUGHNESS_CHANNEL, decode_maps
from metapp.apps.svbrdf_nonstationary.several.app import LIGHT_FLOOR, SeveralPhotos, decode_flashes
from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules import append_axes
from metapp.learning.rules.rule import Part
from metapp.learning.task import Batch, Params

TEXEL_NUMBERS = sum(CHANNELS)
SHAPE_CHANNELS = 0, 1, ROUGHNESS_CHANNEL  # slopes and roughness among a texel's numbers, on which all channels depend
FLASH_STRIDE = 4  # flashes are solved on every fourth row and column
DAMPING = 0.03  # added to the diagonal of normal equations, beside the prior
MAX_CHANGE = (
    0.3,
    0.3,
    *(TEXEL_NUMBERS - 2) * (1.0,),
)  # soft bound (tanh) of the change of each number of a texel in a step
MAX_FLASH_CHANGE = 0.5  # hard bound of the change of each number of a flash in a step
DIFFERENCE_STEP = 1e-3  # step of central differences, in the numbers of texels and flashes


@dataclass(frozen=True)
class GaussNewton(Loss):
    """A loss of several photographs whose steps see Gauss-Newton's change in place of a gradient.

    Attributes:
        settings: a function of learned loss parameters and of a tensor [T, ...], which returns all loss parameters,
            [T, ...]; see :meth:`SeveralPhotos.settings`.
    """

    settings: Callable[[Params, Tensor], Params] = field(kw_only=True)

    @override
    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """Return the change of maps and flashes in place of a gradient, and the losses [T]."""
        with torch.set_grad_enabled(graph):
            change = gauss_newton_change(theta, batch, self.settings(learned, theta["maps"]))
        with torch.no_grad():
            losses = self.value(theta, batch, learned)
        return change, losses


class Newton(Part):
    """The part of a rule that takes Gauss-Newton steps times a learned length, whose logs are `length` [steps]."""

    name = "newton"
    is_rate = True

    @override
    def refusal(self, app: App, theta: Params) -> str:
        return "" if isinstance(app, SeveralPhotos) else "its fits are not maps under flashes of several photographs"

    @override
    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Return logs of lengths, `length` [steps], that are 0, so that steps are whole."""
        return {"length": torch.zeros(steps)}

    @override
    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the loss whose gradient is the Gauss-Newton step."""
        assert isinstance(app, SeveralPhotos)
        return GaussNewton(loss.draw, loss.value, loss.shared, settings=app.settings)

    @override
    def updates(self, alpha: Params, updates: Params) -> Params:
        """Multiply changes by the learned lengths."""
        return {key: append_axes(torch.exp(alpha["length"]), change) * change for key, change in updates.items()}


def gauss_newton_change(
    theta: Params, batch: Batch, settings: Params, *, max_texel_change: Sequence[float] = MAX_CHANGE
) -> Params:
    """Return the Gauss-Newton step of `maps` [T, 9, H, W] and `flash` [T, 4, N], which is to be subtracted.

    Least squares are reweighted, as the loss is of rounded |differences|.

    Args:
        theta: `maps`, `flash` and `prior`.
        batch: `photos` and `places`.
        settings: all loss parameters, [T, ...].
        max_texel_change: the largest change of each of the nine numbers of a texel.
    """
    maps, flash, prior, photos = theta["maps"], theta["flash"], theta["prior"], batch["photos"]
    texels = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device)
    coarse_maps, coarse_photos, coarse_prior, coarse_texels = (
        part[..., FLASH_STRIDE // 2 :: FLASH_STRIDE, FLASH_STRIDE // 2 :: FLASH_STRIDE]
        for part in (maps, photos, prior, texels)
    )
    flash_change = _solve_flashes(
        coarse_maps, flash, coarse_photos, batch["places"], coarse_prior, coarse_texels, settings
    )
    rows, weight, residual = _linearise(maps, flash - flash_change, photos, batch["places"], texels, settings)
    matrix, moment = _build_normal_equations(rows, weight, residual, maps, prior, settings)
    change = _solve(matrix, moment[..., None])[..., 0].unflatten(1, maps.shape[-2:]).permute(0, 3, 1, 2)
    max_change = maps.new_tensor(max_texel_change)[:, None, None]
    return {"maps": max_change * torch.tanh(change / max_change), "flash": flash_change}


def _linearise(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, texels: Tensor, settings: Params
) -> tuple[Tensor, Tensor, Tensor]:
    """Linearise log radiance in the numbers of P texels, for N photographs with three channels each.

    Returns:
        Derivatives [T, P, 3N, 9], weights and residuals [T, P, 3N].
    """
    # each colour depends on one number alone, so that all these numbers can change at once
    (diffuse, specular), increased, decreased = (
        decode_maps(maps + change)[:2] for change in (0, DIFFERENCE_STEP, -DIFFERENCE_STEP)
    )
    diffuse_derivative, specular_derivative = (
        (upper - lower) / (2 * DIFFERENCE_STEP) for upper, lower in zip(increased, decreased, strict=True)
    )
    lobes = _render_lobes(maps, flash, places, texels)
    body, lobe = lobes.split(1, 2)
    slope_x, slope_y, roughness = (
        _combine_lobes(derivative, diffuse, specular)[:, :, None]
        for derivative in _differentiate(lambda raw: _render_lobes(raw, flash, places, texels), maps, SHAPE_CHANNELS)
    )
    # a channel of the photograph depends on the colours of that channel alone
    identity = torch.eye(3, device=maps.device)[:, :, None, None]
    diffuse_rows = (body * ((1 - specular) * diffuse_derivative)[:, None])[:, :, None] * identity
    specular_rows = ((lobe - body * diffuse[:, None]) * specular_derivative[:, None])[:, :, None] * identity
    radiance = _combine_lobes(lobes, diffuse, specular) + LIGHT_FLOOR
    rows = torch.cat([slope_x, slope_y, diffuse_rows, roughness, specular_rows], 2) / radiance[:, :, None]
    rows = rows.permute(0, 4, 5, 1, 3, 2).reshape(len(maps), -1, 3 * photos.shape[1], TEXEL_NUMBERS)
    residual = radiance.log() - (photos + LIGHT_FLOOR).log()
    rounding = append_axes(settings["smoothing"].exp(), residual)
    weight = (residual.square() + rounding * rounding).rsqrt()
    weight = torch.where((photos > CLIPPED_VALUE) & (residual > 0), 0, weight)  # a clipped photograph is a lower bound
    weight, residual = (part.flatten(1, 2).flatten(2).mT.contiguous() for part in (weight, residual))
    return rows, weight, residual


def _render_lobes(maps: Tensor, flash: Tensor, places: Tensor, texels: Tensor) -> Tensor:
    """Return the radiance of a white diffuse surface and of a lobe that reflects all light, [T, N, 2, h, w]."""
    flashes, material = decode_flashes(flash, places), decode_maps(maps)
    white = maps.new_tensor([1.0, 0.0])[:, None, None]
    surface = Maps(white, white.flip(0), material.roughness[:, None], material.normal[:, None])
    return render_maps(surface, texels, flashes.place, flashes.eye, intensity=flashes.gain)


def _combine_lobes(lobes: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    """Return the radiance [T, N, 3, h, w] of colours [T, 3, h, w], from what :func:`_render_lobes` returns."""
    body, lobe = lobes.split(1, 2)
    radiance: Tensor = body * (diffuse * (1 - specular))[:, None] + lobe * specular[:, None]
    return radiance


def _differentiate(function: Callable[[Tensor], Tensor], values: Tensor, channels: Iterable[int]) -> list[Tensor]:
    """Differentiate a function of a tensor [T, K, ...] by the given ones of its K channels, by central differences.

    Forward differentiation by torch is as fast, but its first use imports for more than a second.
    """
    results = []
    for channel in channels:
        step = torch.zeros_like(values)
        step[:, channel] = DIFFERENCE_STEP
        results.append((function(values + step) - function(values - step)) / (2 * DIFFERENCE_STEP))
    return results


def _build_normal_equations(
    rows: Tensor, weight: Tensor, residual: Tensor, maps: Tensor, prior: Tensor, settings: Params
) -> tuple[Tensor, Tensor]:
    """Return the matrix [T, P, 9, 9] and the right side [T, P, 9] of the normal equations of each texel."""
    mean, deviation = prior.chunk(2, 1)
    precision = torch.exp(-2 * deviation)
    displacement = maps - mean
    prior_weight = (
        3 * settings["prior"].exp()[:, :, None, None] * precision / (1 + displacement.square() * precision).sqrt()
    )
    prior_weight, displacement = (part.flatten(2).mT for part in (prior_weight, displacement))
    weighted = (rows * weight[..., None]).mT
    matrix = weighted @ rows + torch.diag_embed(prior_weight + DAMPING)
    return matrix, (weighted @ residual[..., None])[..., 0] + prior_weight * displacement


def _solve_flashes(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, prior: Tensor, texels: Tensor, settings: Params
) -> Tensor:
    """Return the Gauss-Newton step of flashes, [T, 4, N], by the Schur complement: numbers of texels are eliminated."""
    count = photos.shape[1]
    rows, weight, residual = _linearise(maps, flash, photos, places, texels, settings)
    matrix, moment = _build_normal_equations(rows, weight, residual, maps, prior, settings)
    diffuse, specular, *_ = decode_maps(maps)

    def logs(flash: Tensor) -> Tensor:
        return (_combine_lobes(_render_lobes(maps, flash, places, texels), diffuse, specular) + LIGHT_FLOOR).log()

    columns = [derivative.flatten(3) for derivative in _differentiate(logs, flash, range(FLASH_NUMBERS))]
    identity = torch.eye(count, dtype=maps.dtype, device=maps.device)  # each photograph depends on one flash
    flash_rows = torch.einsum("nm,tncpf->tpncmf", identity, torch.stack(columns, -1)).flatten(4).flatten(2, 3)
    weighted = (flash_rows * weight[..., None]).mT
    coupling = rows.mT @ weighted.mT
    eliminated = _solve(matrix, torch.cat([coupling, moment[..., None]], -1))
    flash_matrix = (weighted @ flash_rows - coupling.mT @ eliminated[..., :-1]).sum(1)
    flash_moment = ((weighted @ residual[..., None])[..., 0] - (coupling.mT @ eliminated[..., -1:])[..., 0]).sum(1)
    damping = torch.where(
        torch.arange(FLASH_NUMBERS, device=maps.device) < 3, 2 * settings["flash"].exp()[:, None], 1e-4
    )
    damping = residual.shape[1] * damping.repeat(1, count)
    flash_matrix = flash_matrix + torch.diag_embed(damping)
    flash_moment = flash_moment + damping * flash.mT.flatten(1)
    change = torch.linalg.solve(flash_matrix.double(), flash_moment.double()).to(maps).reshape(-1, count, FLASH_NUMBERS)
    bounded: Tensor = change.mT.clamp(-MAX_FLASH_CHANGE, MAX_FLASH_CHANGE)
    return bounded


def _solve(matrix: Tensor, right_side: Tensor) -> Tensor:
    """Solve linear equations [T, P, 9, 9] with right sides [T, P, 9, K] by Cholesky decomposition."""
    return torch.cholesky_solve(right_side, torch.linalg.cholesky(matrix))

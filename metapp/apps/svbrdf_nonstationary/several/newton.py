"""Gauss-Newton steps of several photographs: the part `newton` of rules.

Texels see each other only through the flashes, as points do through the cameras in bundle adjustment (Triggs et al.
2000): the Schur complement gives the flashes, a system of 9 numbers each texel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

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
DAMPING = 0.03  # of normal equations, beside the prior
MAX_CHANGE = (0.3, 0.3, *(TEXEL_NUMBERS - 2) * (1.0,))  # of each number of a texel in a step
MAX_FLASH_CHANGE = 0.5  # of each number of a flash in a step
DIFFERENCE_STEP = 1e-3  # of central differences by numbers of texels and flashes


@dataclass(frozen=True)
class GaussNewton(Loss):
    """A loss of several photographs whose steps see Gauss-Newton's change in place of a gradient.

    Attributes:
        settings: a function of learned parameters of the loss and a tensor [T, ...] that returns all parameters of
            the loss, [T, ...].
    """

    settings: Callable[[Params, Tensor], Params] = field(kw_only=True)

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """Return the change of maps and flashes, to be subtracted, and the losses [T]."""
        with torch.set_grad_enabled(graph):
            change = gauss_newton_change(theta, batch, self.settings(learned, theta["maps"]))
        with torch.no_grad():
            losses = self.value(theta, batch, learned)
        return change, losses


class Newton(Part):
    """The part of a rule that takes Gauss-Newton steps times a learned length, whose logs are `length` [steps]."""

    name = "newton"
    is_rate = True

    def refusal(self, app: App, theta: Params) -> str:
        """Refuse applications whose fits are not maps of several photographs."""
        return "" if isinstance(app, SeveralPhotos) else "its fits are not maps under flashes of several photographs"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """Return logs of lengths that take whole steps."""
        return {"length": torch.zeros(steps)}

    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the loss whose gradient is the Gauss-Newton step."""
        assert isinstance(app, SeveralPhotos)
        return GaussNewton(loss.draw, loss.value, loss.shared, settings=app.settings)

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Multiply changes by the learned lengths."""
        return {key: append_axes(torch.exp(alpha["length"]), change) * change for key, change in updates.items()}


def gauss_newton_change(
    theta: Params, batch: Batch, settings: Params, *, longest_of_texel: Sequence[float] = MAX_CHANGE
) -> Params:
    """Return the Gauss-Newton step of `maps` [T, 9, H, W] and `flash` [T, 4, N], to be subtracted.

    Least squares are reweighted, as the loss is of rounded |differences|.

    Args:
        theta: `maps`, `flash` and `prior`.
        batch: `photos` and `places`.
        settings: all parameters of the loss, [T, ...].
        longest_of_texel: the greatest change of each of the nine numbers of a texel.
    """
    maps, flash, prior, photos = theta["maps"], theta["flash"], theta["prior"], batch["photos"]
    texels = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device)
    few = [
        part[..., FLASH_STRIDE // 2 :: FLASH_STRIDE, FLASH_STRIDE // 2 :: FLASH_STRIDE]
        for part in (maps, photos, prior, texels)
    ]
    of_flash = _flash_change(few[0], flash, few[1], batch["places"], few[2], few[3], settings)
    rows, weight, short = _linearise(maps, flash - of_flash, photos, batch["places"], texels, settings)
    matrix, moment = _normal_equations(rows, weight, short, maps, prior, settings)
    change = _solve(matrix, moment[..., None])[..., 0].unflatten(1, maps.shape[-2:]).permute(0, 3, 1, 2)
    longest = maps.new_tensor(longest_of_texel)[:, None, None]
    return {"maps": longest * torch.tanh(change / longest), "flash": of_flash}


def _linearise(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, texels: Tensor, settings: Params
) -> tuple[Tensor, Tensor, Tensor]:
    """Return derivatives of log radiance by the numbers of texels, [T, P, 3N, 9], weights and residuals, [T, P, 3N]."""
    # a channel's colours depend on its own numbers alone: these can change all at once
    (diffuse, specular), more, less = (
        decode_maps(maps + change)[:2] for change in (0, DIFFERENCE_STEP, -DIFFERENCE_STEP)
    )
    along_diffuse, along_specular = ((up - down) / (2 * DIFFERENCE_STEP) for up, down in zip(more, less, strict=True))
    lobes = _lobes(maps, flash, places, texels)
    body, lobe = lobes.split(1, 2)
    slope_x, slope_y, roughness = (
        _combine_lobes(along, diffuse, specular)[:, :, None]
        for along in _derivatives(lambda raw: _lobes(raw, flash, places, texels), maps, SHAPE_CHANNELS)
    )
    own = torch.eye(3, device=maps.device)[:, :, None, None]  # a channel's colours are its own
    by_diffuse = (body * ((1 - specular) * along_diffuse)[:, None])[:, :, None] * own
    by_specular = ((lobe - body * diffuse[:, None]) * along_specular[:, None])[:, :, None] * own
    radiance = _combine_lobes(lobes, diffuse, specular) + LIGHT_FLOOR
    rows = torch.cat([slope_x, slope_y, by_diffuse, roughness, by_specular], 2) / radiance[:, :, None]
    rows = rows.permute(0, 4, 5, 1, 3, 2).reshape(len(maps), -1, 3 * photos.shape[1], TEXEL_NUMBERS)
    short = radiance.log() - (photos + LIGHT_FLOOR).log()
    rounding = append_axes(settings["smoothing"].exp(), short)
    weight = (short.square() + rounding * rounding).rsqrt()
    weight = torch.where((photos > CLIPPED_VALUE) & (short > 0), 0, weight)  # a clipped photograph is a lower bound
    weight, short = (part.flatten(1, 2).flatten(2).mT.contiguous() for part in (weight, short))
    return rows, weight, short


def _lobes(maps: Tensor, flash: Tensor, places: Tensor, texels: Tensor) -> Tensor:
    """Return the radiance of a white diffuse surface and of a lobe that reflects all light, [T, N, 2, h, w]."""
    flashes, material = decode_flashes(flash, places), decode_maps(maps)
    white = maps.new_tensor([1.0, 0.0])[:, None, None]
    surface = Maps(white, white.flip(0), material.roughness[:, None], material.normal[:, None])
    return render_maps(surface, texels, flashes.place, flashes.eye, intensity=flashes.gain)


def _combine_lobes(lobes: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    """Return the radiance [T, N, 3, h, w] of diffuse and specular colours [T, 3, h, w] by the lobes of `_lobes`."""
    body, lobe = lobes.split(1, 2)
    radiance: Tensor = body * (diffuse * (1 - specular))[:, None] + lobe * specular[:, None]
    return radiance


def _derivatives(function: Callable[[Tensor], Tensor], at: Tensor, channels: Iterable[int]) -> list[Tensor]:
    """Return central differences of a function of a tensor [T, K, ...] by some of its K channels.

    Forward differentiation by torch is as fast, but its first use imports for more than a second.
    """
    results = []
    for channel in channels:
        along = torch.zeros_like(at)
        along[:, channel] = DIFFERENCE_STEP
        results.append((function(at + along) - function(at - along)) / (2 * DIFFERENCE_STEP))
    return results


def _normal_equations(
    rows: Tensor, weight: Tensor, short: Tensor, maps: Tensor, prior: Tensor, settings: Params
) -> tuple[Tensor, Tensor]:
    """Return the matrix [T, P, 9, 9] and the moment [T, P, 9] of each texel, summed over photographs and channels."""
    mean, deviation = prior.chunk(2, 1)
    precision = torch.exp(-2 * deviation)
    off = maps - mean
    pull = 3 * settings["prior"].exp()[:, :, None, None] * precision / (1 + off.square() * precision).sqrt()
    pull, off = (each.flatten(2).mT for each in (pull, off))
    weighted = (rows * weight[..., None]).mT
    matrix = weighted @ rows + torch.diag_embed(pull + DAMPING)
    return matrix, (weighted @ short[..., None])[..., 0] + pull * off


def _flash_change(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, prior: Tensor, texels: Tensor, settings: Params
) -> Tensor:
    """Return the Gauss-Newton step of flashes, [T, 4, N], numbers of texels eliminated."""
    count = photos.shape[1]
    rows, weight, short = _linearise(maps, flash, photos, places, texels, settings)
    matrix, moment = _normal_equations(rows, weight, short, maps, prior, settings)
    diffuse, specular, *_ = decode_maps(maps)

    def logs(flash: Tensor) -> Tensor:
        return (_combine_lobes(_lobes(maps, flash, places, texels), diffuse, specular) + LIGHT_FLOOR).log()

    columns = [derivative.flatten(3) for derivative in _derivatives(logs, flash, range(FLASH_NUMBERS))]
    of_photo = torch.eye(count, dtype=maps.dtype, device=maps.device)  # a photograph sees its own flash
    of_flash = torch.einsum("nm,tncpf->tpncmf", of_photo, torch.stack(columns, -1)).flatten(4).flatten(2, 3)
    weighted = (of_flash * weight[..., None]).mT
    both = rows.mT @ weighted.mT
    eliminated = _solve(matrix, torch.cat([both, moment[..., None]], -1))
    left = (weighted @ of_flash - both.mT @ eliminated[..., :-1]).sum(1)
    right = ((weighted @ short[..., None])[..., 0] - (both.mT @ eliminated[..., -1:])[..., 0]).sum(1)
    moved = torch.where(torch.arange(FLASH_NUMBERS, device=maps.device) < 3, 2 * settings["flash"].exp()[:, None], 1e-4)
    moved = short.shape[1] * moved.repeat(1, count)
    left = left + torch.diag_embed(moved)
    right = right + moved * flash.mT.flatten(1)
    change = torch.linalg.solve(left.double(), right.double()).to(maps).reshape(-1, count, FLASH_NUMBERS)
    bounded: Tensor = change.mT.clamp(-MAX_FLASH_CHANGE, MAX_FLASH_CHANGE)
    return bounded


def _solve(matrix: Tensor, right: Tensor) -> Tensor:
    return torch.cholesky_solve(right, torch.linalg.cholesky(matrix))

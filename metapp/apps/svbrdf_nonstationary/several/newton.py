"""Gauss-Newton steps of several photographs: the part `newton` of rules.

Texels see each other only through the flashes, as points do through the cameras in bundle adjustment (Triggs et al.
2000): the Schur complement gives the flashes, a system of 9 numbers each texel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from metapp.appearance.flash import Maps, positions, render
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED_VALUE, FLASH, RAW, ROUGHNESS, decoded
from metapp.apps.svbrdf_nonstationary.several.app import FLOOR, SeveralPhotos, flashes_of
from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules import append_axes
from metapp.learning.rules.rule import Part
from metapp.learning.task import Batch, Params

NUMBERS = sum(RAW)
SHAPE = 0, 1, ROUGHNESS  # slopes and roughness among a texel's numbers, on which all channels depend
COARSE = 4  # every such row and column is enough for flashes
DAMPING = 0.03  # of normal equations, beside the prior
LONGEST = (0.3, 0.3, *(NUMBERS - 2) * (1.0,))  # change of a number of a texel in a step
LONGEST_OF_FLASH = 0.5
DIFFERENCE = 1e-3  # of numbers of texels and flashes


@dataclass(frozen=True)
class GaussNewton(Loss):
    """A loss of several photographs whose steps see Gauss-Newton's change in place of a gradient.

    Attributes:
        settings: learned parameters of the loss -> all of them, with a task axis.
    """

    settings: Callable[[Params, Tensor], Params] = field(kw_only=True)

    def gradient(self, theta: Params, batch: AnyBatch, learned: Params, *, graph: bool) -> tuple[Params, Tensor]:
        """The change of maps and flashes, to subtract, and the loss."""
        with torch.set_grad_enabled(graph):
            change = changes(theta, batch, self.settings(learned, theta["maps"]))
        with torch.no_grad():
            losses = self.value(theta, batch, learned)
        return change, losses


class Newton(Part):
    """Gauss-Newton's change times a learned length: `length` [steps], logarithms."""

    name = "newton"
    is_rate = True

    def refusal(self, app: App, theta: Params) -> str:
        """It needs maps of which each texel is seen by itself."""
        return "" if isinstance(app, SeveralPhotos) else "its fits are not maps under flashes of several photographs"

    def initial(self, app: App, theta: Params, steps: int, first: Adam) -> Params:
        """The whole change."""
        return {"length": torch.zeros(steps)}

    def loss(self, app: App, loss: Loss) -> Loss:
        """Changes of the same loss."""
        assert isinstance(app, SeveralPhotos)
        return GaussNewton(loss.draw, loss.value, loss.shared, settings=app.settings)

    def updates(self, alpha: Params, updates: Params) -> Params:
        """Length times change."""
        return {key: append_axes(torch.exp(alpha["length"]), change) * change for key, change in updates.items()}


def changes(theta: Params, batch: Batch, settings: Params, *, longest_of_texel: Sequence[float] = LONGEST) -> Params:
    """Gauss-Newton's change of `maps` [T, 9, H, W] and `flash` [T, 4, N], to subtract, by reweighted least squares.

    Args:
        theta: maps, flashes, and the prior.
        batch: `photos` and `places`.
        settings: those of the loss, with a task axis.
        longest_of_texel: the greatest change of each of the nine numbers of a texel.
    """
    maps, flash, prior, photos = theta["maps"], theta["flash"], theta["prior"], batch["photos"]
    texels = positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device)
    few = [part[..., COARSE // 2 :: COARSE, COARSE // 2 :: COARSE] for part in (maps, photos, prior, texels)]
    of_flash = _change_of_flashes(few[0], flash, few[1], batch["places"], few[2], few[3], settings)
    rows, weight, short = _rows(maps, flash - of_flash, photos, batch["places"], texels, settings)
    matrix, moment = _normal_equations(rows, weight, short, maps, prior, settings)
    change = _solved(matrix, moment[..., None])[..., 0].unflatten(1, maps.shape[-2:]).permute(0, 3, 1, 2)
    longest = maps.new_tensor(longest_of_texel)[:, None, None]
    return {"maps": longest * torch.tanh(change / longest), "flash": of_flash}


def _rows(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, texels: Tensor, settings: Params
) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives [T, P, 3N, 9] of the logs of radiance in a texel's numbers, weights, and residuals [T, P, 3N]."""
    # a channel's colours depend on its own numbers alone: these can change all at once
    (diffuse, specular), more, less = (decoded(maps + change)[:2] for change in (0, DIFFERENCE, -DIFFERENCE))
    along_diffuse, along_specular = ((up - down) / (2 * DIFFERENCE) for up, down in zip(more, less, strict=True))
    lobes = _lobes(maps, flash, places, texels)
    body, lobe = lobes.split(1, 2)
    slope_x, slope_y, roughness = (
        _seen(along, diffuse, specular)[:, :, None]
        for along in _derivatives(lambda raw: _lobes(raw, flash, places, texels), maps, SHAPE)
    )
    own = torch.eye(3, device=maps.device)[:, :, None, None]  # a channel's colours are its own
    by_diffuse = (body * ((1 - specular) * along_diffuse)[:, None])[:, :, None] * own
    by_specular = ((lobe - body * diffuse[:, None]) * along_specular[:, None])[:, :, None] * own
    radiance = _seen(lobes, diffuse, specular) + FLOOR
    rows = torch.cat([slope_x, slope_y, by_diffuse, roughness, by_specular], 2) / radiance[:, :, None]
    rows = rows.permute(0, 4, 5, 1, 3, 2).reshape(len(maps), -1, 3 * photos.shape[1], NUMBERS)
    short = radiance.log() - (photos + FLOOR).log()
    rounding = append_axes(settings["smoothing"].exp(), short)
    weight = (short.square() + rounding * rounding).rsqrt()
    weight = torch.where((photos > CLIPPED_VALUE) & (short > 0), 0, weight)  # a clipped photograph is a lower bound
    weight, short = (part.flatten(1, 2).flatten(2).mT.contiguous() for part in (weight, short))
    return rows, weight, short


def _lobes(maps: Tensor, flash: Tensor, places: Tensor, texels: Tensor) -> Tensor:
    """Radiance [T, N, 2, h, w] of a white body, and of a lobe that reflects all, by slopes and roughness."""
    flashes, material = flashes_of(flash, places), decoded(maps)
    white = maps.new_tensor([1.0, 0.0])[:, None, None]
    surface = Maps(white, white.flip(0), material.roughness[:, None], material.normal[:, None])
    return render(surface, texels, flashes.place, flashes.eye, intensity=flashes.gain)


def _seen(lobes: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    """Radiance [T, N, 3, h, w] of colours [T, 3, h, w] by `_lobes`."""
    body, lobe = lobes.split(1, 2)
    radiance: Tensor = body * (diffuse * (1 - specular))[:, None] + lobe * specular[:, None]
    return radiance


def _derivatives(function: Callable[[Tensor], Tensor], at: Tensor, channels: Iterable[int]) -> list[Tensor]:
    """Central differences of a function of [T, K, ...] along channels.

    Forward differentiation by torch is as fast, but its first use imports for more than a second.
    """
    results = []
    for channel in channels:
        along = torch.zeros_like(at)
        along[:, channel] = DIFFERENCE
        results.append((function(at + along) - function(at - along)) / (2 * DIFFERENCE))
    return results


def _normal_equations(
    rows: Tensor, weight: Tensor, short: Tensor, maps: Tensor, prior: Tensor, settings: Params
) -> tuple[Tensor, Tensor]:
    """Matrix [T, P, 9, 9] and moment [T, P, 9] of each texel, in the scale of sums over photographs and channels."""
    mean, deviation = prior.chunk(2, 1)
    precision = torch.exp(-2 * deviation)
    off = maps - mean
    pull = 3 * settings["prior"].exp()[:, :, None, None] * precision / (1 + off.square() * precision).sqrt()
    pull, off = (each.flatten(2).mT for each in (pull, off))
    weighted = (rows * weight[..., None]).mT
    matrix = weighted @ rows + torch.diag_embed(pull + DAMPING)
    return matrix, (weighted @ short[..., None])[..., 0] + pull * off


def _change_of_flashes(
    maps: Tensor, flash: Tensor, photos: Tensor, places: Tensor, prior: Tensor, texels: Tensor, settings: Params
) -> Tensor:
    """Gauss-Newton's change of flashes [T, 4, N] after texels are eliminated."""
    count = photos.shape[1]
    rows, weight, short = _rows(maps, flash, photos, places, texels, settings)
    matrix, moment = _normal_equations(rows, weight, short, maps, prior, settings)
    diffuse, specular, *_ = decoded(maps)

    def logs(flash: Tensor) -> Tensor:
        return (_seen(_lobes(maps, flash, places, texels), diffuse, specular) + FLOOR).log()

    columns = [derivative.flatten(3) for derivative in _derivatives(logs, flash, range(FLASH))]
    of_photo = torch.eye(count, dtype=maps.dtype, device=maps.device)  # a photograph sees its own flash
    of_flash = torch.einsum("nm,tncpf->tpncmf", of_photo, torch.stack(columns, -1)).flatten(4).flatten(2, 3)
    weighted = (of_flash * weight[..., None]).mT
    both = rows.mT @ weighted.mT
    eliminated = _solved(matrix, torch.cat([both, moment[..., None]], -1))
    left = (weighted @ of_flash - both.mT @ eliminated[..., :-1]).sum(1)
    right = ((weighted @ short[..., None])[..., 0] - (both.mT @ eliminated[..., -1:])[..., 0]).sum(1)
    moved = torch.where(torch.arange(FLASH, device=maps.device) < 3, 2 * settings["flash"].exp()[:, None], 1e-4)
    moved = short.shape[1] * moved.repeat(1, count)
    left = left + torch.diag_embed(moved)
    right = right + moved * flash.mT.flatten(1)
    change = torch.linalg.solve(left.double(), right.double()).to(maps).reshape(-1, count, FLASH)
    bounded: Tensor = change.mT.clamp(-LONGEST_OF_FLASH, LONGEST_OF_FLASH)
    return bounded


def _solved(matrix: Tensor, right: Tensor) -> Tensor:
    return torch.cholesky_solve(right, torch.linalg.cholesky(matrix))

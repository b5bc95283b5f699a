"""Gauss-Newton steps of several photographs: the part `newton` of rules.

Once the flashes are known, photographs tell of each texel by itself, as of each point in bundle adjustment once the
cameras are known (Triggs et al. 2000). So a step eliminates all texels by a Schur complement and solves one system for
the 4 N numbers of N flashes and the fall-off that they share. Then it eliminates the colours and the roughness of each
texel, and solves one system for the slopes of all texels, which their curl couples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import softplus
from typing_extensions import override

from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photo, render_photos
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, CLIPPED_LINEAR_VALUE, ROUGHNESS_CHANNEL, decode_maps
from metapp.apps.svbrdf_nonstationary.multi_photo.flash_gains import LIGHT_FLOOR
from metapp.apps.svbrdf_nonstationary.multi_photo.integrability import (
    RELATIVE_RESIDUAL,
    find_curl,
    find_slopes_of_curl,
    solve_slopes,
)
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_set_sight import CURL_ROUNDING, FALLOFF_WEIGHT, PhotoSetSight
from metapp.learning.adjoint import AnyBatch, Loss
from metapp.learning.app import App
from metapp.learning.recipe import Adam
from metapp.learning.rules import LearnedRule, append_axes
from metapp.learning.rules.parts import LossParameters
from metapp.learning.rules.rule import Part
from metapp.learning.task import Batch, Params

# The unbounded numbers of N flashes, [T, 4, N], and the fall-off that they share, [T, 1]
FlashNumbers = tuple[Tensor, Tensor]
TEXEL_NUMBERS = sum(CHANNELS)
SHAPE_CHANNELS = 0, 1, ROUGHNESS_CHANNEL  # a texel's slopes and roughness, on which all three colour channels depend
FLASH_STRIDE = 4  # flashes are solved from the texels of every fourth row and column alone
TEXEL_DAMPING = 0.03  # added to the diagonal of a texel's normal equations (Levenberg), beside the prior's weights
# Weight that draws gains of flashes, which are free otherwise, to 1: without it the equations could be singular.
GAIN_DAMPING = 1e-4
# Soft bounds (tanh) of the change of each number of a texel in a step: first its two slopes, then the others
MAX_CHANGE = (0.3, 0.3, *(TEXEL_NUMBERS - 2) * (1.0,))
MAX_FLASH_CHANGE = 0.5  # hard bound of the change of each number of a flash, and of the fall-off, in a step
NOISE_POWER, RELIEF_NOISE_POWER = 4.0, 6.0  # see :func:`_weigh_by_noise`
MIN_NOISE = 1e-3  # log radiance: |residuals| are rounded off below, before their geometric mean is taken
GENERAL_NOISE_SHARE = 0.2  # noise that a fit is expected to leave, over the noise of its prior's maps
DIFFERENCE_STEP = 1e-3  # step of central differences, in the numbers of texels and flashes


@dataclass(frozen=True)
class GaussNewton(Loss):
    """A loss of fits to several photographs that gives update rules a Gauss-Newton step in place of its gradient.

    An update rule subtracts this step, times a learned length, as it would subtract a gradient times a rate.

    Attributes:
        settings: a function that returns all loss parameters [T, ...]: those that a rule has learned, its first
            argument, or initial values if that is {}. Its second argument is a tensor [T, ...] of the fits; see
            :meth:`PhotoSetSight.settings`.
        flash_stride, relative_residual: see :func:`gauss_newton_change`.
    """

    settings: Callable[[Params, Tensor], Params] = field(kw_only=True)
    flash_stride: int = field(default=FLASH_STRIDE, kw_only=True)
    relative_residual: float = field(default=RELATIVE_RESIDUAL, kw_only=True)

    @override
    def gradient(
        self, theta: Params, batch: AnyBatch, loss_parameters: Params, *, graph: bool
    ) -> tuple[Params, Tensor]:
        """Return the Gauss-Newton step of the parameters in place of a gradient, and the loss of each task, [T]."""
        with torch.set_grad_enabled(graph):
            change = gauss_newton_change(
                theta,
                batch,
                self.settings(loss_parameters, theta["maps"]),
                flash_stride=self.flash_stride,
                relative_residual=self.relative_residual,
            )
        with torch.no_grad():
            losses = self.value(theta, batch, loss_parameters)
        return change, losses


class Newton(Part):
    """The part of a rule that takes Gauss-Newton steps, each times a learned length.

    Its hyperparameter `length` [steps] holds the natural logs of the lengths, one for each step of a fit.
    """

    name = "newton"

    @override
    def refusal(self, app: App, theta: Params) -> str:
        """Return "" for fits that see several photographs, to which alone the part applies, else why it does not."""
        return "" if _find_sight(app) else "its fits are not maps under flashes of several photographs"

    @override
    def initial(self, app: App, theta: Params, steps: int, adam: Adam) -> Params:
        """Return `length` [steps], zeros: they are logs, so that each step has length 1, a whole Gauss-Newton step."""
        return {"length": torch.zeros(steps)}

    @override
    def loss(self, app: App, loss: Loss) -> Loss:
        """Return the given loss as one that gives steps Gauss-Newton's step in place of its gradient."""
        sight = _find_sight(app)
        assert sight is not None
        return GaussNewton(loss.draw, loss.value, loss.shared, settings=sight.settings)

    @override
    def updates(self, alpha: Params, updates: Params) -> Params:
        """Multiply the changes [T, ...] by the length of this step, whose log is `length` [T] in `alpha`."""
        return {key: append_axes(torch.exp(alpha["length"]), change) * change for key, change in updates.items()}


GAUSS_NEWTON = LearnedRule("gauss-newton", (Newton(), LossParameters()))


def _find_sight(app: App) -> PhotoSetSight | None:
    """Return what fits of an application see if that is several photographs, else None."""
    return app.sight if isinstance(app.sight, PhotoSetSight) else None


def gauss_newton_change(
    theta: Params,
    batch: Batch,
    settings: Params,
    *,
    max_texel_change: Sequence[float] = MAX_CHANGE,
    flash_stride: int = FLASH_STRIDE,
    relative_residual: float = RELATIVE_RESIDUAL,
) -> Params:
    """Return the Gauss-Newton step of `maps`, `flash` and `falloff`, which is to be subtracted.

    The step of the flashes and their fall-off is solved first, from the texels of some rows and columns alone; then the
    step of the texels, under the flashes after their step. Texels depend on each other through the curl of
    their slopes alone.

    The loss of a difference d between log rendering and log photograph is no square: it is the absolute difference,
    smoothed near 0, sqrt(d^2 + s^2) - s. So each step solves a least-squares problem in which d^2 has the weight
    1 / sqrt(d^2 + s^2), by the present d (iteratively reweighted least squares). The right side of a texel's normal
    equations is 3 N times the gradient of :meth:`PhotoSetSight.loss`, whose weights of prior and curl are first raised
    where photographs are noisy, see :func:`_weigh_by_noise`. For N photographs with three colour channels each the loss
    takes the mean of 3 N differences at each texel, and least squares take their sum.

    Args:
        theta: the fits: `maps` [T, 9, H, W], `flash` [T, 4, N], `falloff` [T, 1] and `prior` [T, 18, H, W].
        batch: what the fits see, by the names of :class:`SeenPhotos`.
        settings: logs of all loss parameters: `smoothing` [T], the log of s; `prior` [T, 9]; `flash`, `curl` and
            `noise` [T].
        max_texel_change: soft bounds of the changes of the nine numbers of a texel: a change c becomes
            bound * tanh(c / bound).
        flash_stride: flashes are solved from the texels of every so many rows and columns, from its half on.
        relative_residual: how exactly the slopes of texels are solved, see :func:`solve_slopes`.
    """
    maps, flash, falloff, prior = (theta[key] for key in ("maps", "flash", "falloff", "prior"))
    settings, photos = _expect_noise(theta, batch, settings), batch["photos"]
    photos = torch.where(batch["shows_material"] > 0, photos, math.nan)
    texels = texel_positions(*maps.shape[-2:], dtype=maps.dtype, device=maps.device)
    coarse_maps, coarse_photos, coarse_prior, coarse_texels = (
        picture[..., flash_stride // 2 :: flash_stride, flash_stride // 2 :: flash_stride]
        for picture in (maps, photos, prior, texels)
    )
    flash_change, falloff_change = _solve_flashes(
        coarse_maps,
        (flash, falloff),
        coarse_photos,
        batch["places"],
        coarse_prior,
        coarse_texels,
        settings,
    )
    moved_flashes = flash - flash_change, falloff - falloff_change
    jacobian, weight, residual = _linearise(maps, moved_flashes, photos, batch["places"], texels, settings)
    settings = _weigh_by_noise(weight, residual, settings)
    matrix, right_side = _build_normal_equations(jacobian, weight, residual, maps, prior, settings)
    change = _solve_texels(matrix, right_side, maps, settings, relative_residual)
    max_change = maps.new_tensor(max_texel_change)[:, None, None]
    return {"maps": max_change * torch.tanh(change / max_change), "flash": flash_change, "falloff": falloff_change}


def _linearise(
    maps: Tensor, flashes: FlashNumbers, photos: Tensor, places: Tensor, texels: Tensor, settings: Params
) -> tuple[Tensor, Tensor, Tensor]:
    """Linearise the log renderings of P texels in their nine numbers, for N photographs with three channels each.

    Args:
        maps: the unbounded numbers of the texels, [T, 9, h, w].
        flashes: the unbounded numbers of the flashes, and their fall-off.
        photos: linear photographs of the texels, [T, N, 3, h, w], NaN where they do not show the material.
        places: measured positions of camera and flash, [T, N, 2, 3].
        texels: positions of the texels in the patch, [2, h, w].
        settings: all loss parameters, [T, ...].

    Returns:
        The derivatives of the log renderings by the numbers of each texel, [T, P, 3N, 9].
        The weights of the squared residuals, [T, P, 3N]: 1 / sqrt(residual^2 + smoothing^2), so that weight times
        residual is the derivative of the smoothed absolute residual; 0 where a clipped photograph agrees with a
        rendering that is brighter, and where a photograph does not show the material.
        The residuals, [T, P, 3N]: log rendering minus log photograph, above 0 where the rendering is too bright.
    """
    # Each channel of a colour depends on one number alone, so that one pair of evaluations differentiates all of them.
    (diffuse, specular), increased, decreased = (
        decode_maps(maps + change)[:2] for change in (0, DIFFERENCE_STEP, -DIFFERENCE_STEP)
    )
    diffuse_derivative, specular_derivative = (
        (upper - lower) / (2 * DIFFERENCE_STEP) for upper, lower in zip(increased, decreased, strict=True)
    )
    lobes = _render_lobes(maps, flashes, places, texels)
    diffuse_lobe, specular_lobe = lobes.split(1, 2)
    by_slope_x, by_slope_y, by_roughness = (
        _combine_lobes(derivative, diffuse, specular)[:, :, None]
        for derivative in _differentiate(lambda raw: _render_lobes(raw, flashes, places, texels), maps, SHAPE_CHANNELS)
    )
    # A channel of the photograph depends on the same channel of the colours alone: derivatives are a diagonal matrix.
    identity = torch.eye(3, device=maps.device)[:, :, None, None]
    by_diffuse = diffuse_lobe * ((1 - specular) * diffuse_derivative)[:, None]
    by_specular = (specular_lobe - diffuse_lobe * diffuse[:, None]) * specular_derivative[:, None]
    by_diffuse, by_specular = (derivative[:, :, None] * identity for derivative in (by_diffuse, by_specular))
    radiance = _combine_lobes(lobes, diffuse, specular) + LIGHT_FLOOR
    jacobian = torch.cat([by_slope_x, by_slope_y, by_diffuse, by_roughness, by_specular], 2) / radiance[:, :, None]
    jacobian = jacobian.permute(0, 4, 5, 1, 3, 2).reshape(len(maps), -1, 3 * photos.shape[1], TEXEL_NUMBERS)
    shows_material = ~photos.isnan()
    residual = torch.where(shows_material, radiance.log() - (photos + LIGHT_FLOOR).log(), 0)
    smoothing = append_axes(settings["smoothing"].exp(), residual)
    weight = (residual.square() + smoothing * smoothing).rsqrt()
    # Where a photograph clips, it is a lower bound of radiance: brighter renderings agree with it.
    weight = torch.where((photos > CLIPPED_LINEAR_VALUE) & (residual > 0) | ~shows_material, 0, weight)
    weight, residual = (values.flatten(1, 2).flatten(2).mT.contiguous() for values in (weight, residual))
    return jacobian, weight, residual


def _expect_noise(theta: Params, batch: Batch, settings: Params) -> Params:
    """Return loss parameters whose `noise` [T] is what a fit is expected to leave of differences from photographs.

    It is the root of the sum of squares of the noise in the settings and of GENERAL_NOISE_SHARE of the noise of the
    prior's maps: where these are far off, as of polished metal, the first steps leave much, too.
    """
    maps = decode_maps(theta["prior"].chunk(2, 1)[0])
    renderings = render_photos(maps, decode_flash(theta["flash"].mT, batch["places"], theta["falloff"], camera="held"))
    photos = batch["photos"]
    residual = ((renderings + LIGHT_FLOOR).log() - (photos + LIGHT_FLOOR).log()).flatten(1)
    is_counted = (batch["shows_material"] > 0).expand_as(photos).flatten(1)
    is_counted = is_counted & ((photos <= CLIPPED_LINEAR_VALUE).flatten(1) | (residual < 0))
    prior_log = math.log(GENERAL_NOISE_SHARE) + _find_noise_log(residual, is_counted)
    return {**settings, "noise": torch.logaddexp(2 * settings["noise"], 2 * prior_log) / 2}


def _find_noise_log(residual: Tensor, is_counted: Tensor) -> Tensor:
    """Return the log of the noise of each task, [T]: of the geometric mean of |residuals|, which outliers hardly move.

    Args:
        residual: differences of logs, [T, ...].
        is_counted: which of them count, bool [T, ...].
    """
    counts = is_counted.to(residual).flatten(1)
    logs = (residual.flatten(1).square() + MIN_NOISE**2).log() / 2
    return (counts * logs).sum(1) / counts.sum(1).clamp_min(1)


def _weigh_by_noise(weight: Tensor, residual: Tensor, settings: Params) -> Params:
    """Return loss parameters whose priors weigh more where photographs have more noise than these hold for.

    Photographs that are registered by hand differ from renderings by more than photographs at exact places: by
    parallax, by parts of a texel, by what a camera does to colours. The weights of the maps' prior and of curls are
    multiplied by 1 plus a power of the noise over the noise in the settings. The power is higher for slopes and curls,
    since relief is what such differences are taken for.

    Args:
        weight, residual: the weights and residuals that :func:`_linearise` returns, [T, P, 3N]; those of weight 0 do
            not count.
        settings: all loss parameters, [T, ...].
    """
    noise_log = (_find_noise_log(residual, weight > 0) - settings["noise"])[:, None]
    powers = noise_log.new_tensor(CHANNELS[0] * [RELIEF_NOISE_POWER] + (TEXEL_NUMBERS - CHANNELS[0]) * [NOISE_POWER])
    excess = softplus(powers * noise_log)
    return {**settings, "prior": settings["prior"] + excess, "curl": settings["curl"] + excess[:, 0]}


def _render_lobes(maps: Tensor, flashes: FlashNumbers, places: Tensor, texels: Tensor) -> Tensor:
    """Return the radiance of the two lobes of reflection, [T, N, 2, h, w].

    The first is the radiance of a diffuse surface of albedo 1, the second the radiance of a glossy surface of specular
    colour 1; :func:`_combine_lobes` gives them their colours.
    """
    flash, falloff = flashes
    material = decode_maps(maps)
    # One rendering makes both lobes, as two "colour channels": in the first the diffuse colour is 1 and the specular
    # colour 0, in the second it is the other way round. The first has no gloss, since Fresnel's reflectance is then
    # (1 - cos)^5, with the cosine of half the angle between flash and camera: nearly 0.
    diffuse_colour = maps.new_tensor([1.0, 0.0])[:, None, None]
    specular_colour = diffuse_colour.flip(0)
    surface = Maps(diffuse_colour, specular_colour, material.roughness[:, None], material.normal[:, None])
    return render_photo(surface, decode_flash(flash.mT, places, falloff, camera="held"), texels)


def _combine_lobes(lobes: Tensor, diffuse: Tensor, specular: Tensor) -> Tensor:
    """Return the radiance [T, N, 3, h, w] of a surface from its lobes and colours.

    Args:
        lobes: the radiance of both lobes that :func:`_render_lobes` returns, [T, N, 2, h, w], or its derivatives by a
            number on which the colours do not depend, such as a slope.
        diffuse: the diffuse colour, [T, 3, h, w].
        specular: the specular colour, [T, 3, h, w].
    """
    diffuse_lobe, specular_lobe = lobes.split(1, 2)
    radiance: Tensor = diffuse_lobe * (diffuse * (1 - specular))[:, None] + specular_lobe * specular[:, None]
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
    jacobian: Tensor,
    weight: Tensor,
    residual: Tensor,
    maps: Tensor,
    prior: Tensor,
    settings: Params,
) -> tuple[Tensor, Tensor]:
    """Return the matrix [T, P, 9, 9] and the right side [T, P, 9] of the normal equations of each texel.

    Args:
        jacobian, weight, residual: the linearised renderings that :func:`_linearise` returns.
        maps: the unbounded numbers of P texels, [T, 9, h, w].
        prior: at each texel the nine numbers that the prior expects, then the natural logs of nine scales,
            [T, 18, h, w]. The prior's loss divides the difference of a number from the expected one by its scale.
        settings: all loss parameters, [T, ...].
    """
    mean, log_scale = prior.chunk(2, 1)
    precision = torch.exp(-2 * log_scale)
    displacement = maps - mean
    # The prior's loss of a displacement d with scale s is sqrt(1 + (d / s)^2) - 1, no square either: it is reweighted.
    reweighting = (1 + displacement.square() * precision).sqrt()
    # The loss divides residuals by 3 N and the prior by N, for N photographs; residuals are a plain sum here, so that
    # the prior counts three times.
    prior_weight = 3 * settings["prior"].exp()[:, :, None, None] * precision / reweighting
    gradient = prior_weight * displacement
    prior_weight, gradient = (values.flatten(2).mT for values in (prior_weight, gradient))
    weighted = (jacobian * weight[..., None]).mT
    matrix = weighted @ jacobian + torch.diag_embed(prior_weight + TEXEL_DAMPING)
    return matrix, (weighted @ residual[..., None])[..., 0] + gradient


def _solve_flashes(
    maps: Tensor,
    flashes: FlashNumbers,
    photos: Tensor,
    places: Tensor,
    prior: Tensor,
    texels: Tensor,
    settings: Params,
) -> FlashNumbers:
    """Return the Gauss-Newton steps of the flashes and of their fall-off, clamped to MAX_FLASH_CHANGE either way.

    The normal equations of flashes and texels together are reduced to the flashes' by a Schur complement, which
    eliminates the numbers of all texels.

    Args:
        maps: the unbounded numbers of P texels, [T, 9, h, w]. The caller passes those of every FLASH_STRIDE-th row and
            column, since few texels suffice for 4 N numbers.
        flashes: the unbounded numbers of the flashes, and their fall-off.
        photos: linear photographs of these texels, [T, N, 3, h, w].
        places: measured positions of camera and flash, [T, N, 2, 3].
        prior: the prior at these texels, [T, 18, h, w].
        texels: positions of these texels in the patch, [2, h, w].
        settings: all loss parameters, [T, ...].
    """
    (flash, falloff), count = flashes, photos.shape[1]
    jacobian, weight, residual = _linearise(maps, flashes, photos, places, texels, settings)
    settings = _weigh_by_noise(weight, residual, settings)
    matrix, right_side = _build_normal_equations(jacobian, weight, residual, maps, prior, settings)
    diffuse, specular, *_ = decode_maps(maps)

    def render_logs(flash: Tensor, falloff: Tensor) -> Tensor:
        lobes = _render_lobes(maps, (flash, falloff), places, texels)
        return (_combine_lobes(lobes, diffuse, specular) + LIGHT_FLOOR).log()

    derivatives = [
        derivative.flatten(3)
        for derivative in _differentiate(lambda numbers: render_logs(numbers, falloff), flash, range(FLASH_NUMBERS))
    ]
    (by_falloff,) = _differentiate(lambda number: render_logs(flash, number), falloff, range(1))
    identity = torch.eye(count, dtype=maps.dtype, device=maps.device)  # each photograph depends on one flash
    flash_jacobian = torch.einsum("nm,tncpf->tpncmf", identity, torch.stack(derivatives, -1)).flatten(4).flatten(2, 3)
    falloff_jacobian = by_falloff.flatten(1, 2).flatten(2).mT[..., None]
    flash_jacobian = torch.cat([flash_jacobian, falloff_jacobian], -1)
    weighted = (flash_jacobian * weight[..., None]).mT
    coupling = jacobian.mT @ weighted.mT
    eliminated = _solve(matrix, torch.cat([coupling, right_side[..., None]], -1))
    flash_matrix = (weighted @ flash_jacobian - coupling.mT @ eliminated[..., :-1]).sum(1)
    flash_right_side = ((weighted @ residual[..., None])[..., 0] - (coupling.mT @ eliminated[..., -1:])[..., 0]).sum(1)
    # Flashes have a prior, too, which draws positions to 0, the measured flash. The loss, a sum over texels, has for
    # each texel a weight times the mean of squares over the three numbers of a position and N photographs: times 3 N,
    # its gradient is 2 * weight * number. It has another weight times the squared fall-off: times 3 N, its gradient is
    # 6 N * weight * number.
    position_weight = (2 * settings["flash"].exp())[:, None, None].expand(-1, FLASH_NUMBERS - 1, count)
    gain_weight = torch.full_like(flash[:, -1:], GAIN_DAMPING)
    falloff_weight = torch.full_like(falloff, 6 * count * FALLOFF_WEIGHT)
    prior_weight = torch.cat([torch.cat([position_weight, gain_weight], 1).mT.flatten(1), falloff_weight], 1)
    prior_weight = residual.shape[1] * prior_weight
    flash_matrix = flash_matrix + torch.diag_embed(prior_weight)
    flash_right_side = flash_right_side + prior_weight * torch.cat([flash.mT.flatten(1), falloff], 1)
    change = torch.linalg.solve(flash_matrix.double(), flash_right_side.double()).to(maps)
    change = change.clamp(-MAX_FLASH_CHANGE, MAX_FLASH_CHANGE)
    return change[:, :-1].reshape(-1, count, FLASH_NUMBERS).mT, change[:, -1:]


def _solve_texels(
    matrix: Tensor, right_side: Tensor, maps: Tensor, settings: Params, relative_residual: float
) -> Tensor:
    """Return the Gauss-Newton step of the texels, [T, 9, H, W], which makes the curl of their slopes small, too.

    All numbers of a texel but its slopes are eliminated first, then solved from the step of the slopes.

    Args:
        matrix: the normal equations of each texel by itself, [T, P, 9, 9].
        right_side: their right side, [T, P, 9].
        maps: the unbounded numbers of the texels, [T, 9, H, W].
        settings: all loss parameters, [T, ...].
        relative_residual: see :func:`solve_slopes`.
    """
    slope_count = CHANNELS[0]
    curl = find_curl(maps[:, :slope_count])
    # As the prior's, the weight counts three times, and curls are no squares either: they are reweighted.
    curl_weight = 3 * settings["curl"].exp()[:, None, None] * (curl.square() + CURL_ROUNDING**2).rsqrt()
    coupling = matrix[..., slope_count:, :slope_count]
    right_sides = torch.cat([coupling, right_side[..., slope_count:, None]], -1)
    eliminated = _solve(matrix[..., slope_count:, slope_count:], right_sides)
    of_coupling, of_right_side = eliminated[..., :slope_count], eliminated[..., slope_count]
    precision = matrix[..., :slope_count, :slope_count] - coupling.mT @ of_coupling
    slope_side = right_side[..., :slope_count] - (coupling.mT @ of_right_side[..., None])[..., 0]
    precision, slope_side = (
        values.unflatten(1, maps.shape[-2:]).movedim((1, 2), (-2, -1)) for values in (precision, slope_side)
    )
    slope_side = slope_side + find_slopes_of_curl(curl_weight * curl)
    slope_change = solve_slopes(precision, curl_weight, slope_side, relative_residual=relative_residual)
    other_change = of_right_side - (of_coupling @ slope_change.flatten(2).mT[..., None])[..., 0]
    return torch.cat([slope_change, other_change.mT.unflatten(2, maps.shape[-2:])], 1)


def _solve(matrix: Tensor, right_sides: Tensor) -> Tensor:
    """Solve linear equations with matrices [T, P, n, n] and right sides [T, P, n, K] by Cholesky decomposition."""
    return torch.cholesky_solve(right_sides, torch.linalg.cholesky(matrix))

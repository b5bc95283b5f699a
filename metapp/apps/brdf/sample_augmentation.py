"""Data augmentation of BRDFs: mixtures of materials, and samples as instruments take them.

Users bring fewer samples than training materials have, noisy ones, or none at grazing angles. A network that was
trained by these functions has seen such samples. The functions change tensors of prepared tasks, and know no network.
"""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import outgoing_cosine
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Params, Tasks

AUGMENTED_SAMPLES = 8192  # samples of an augmented material
DENSE_SHARE, FEWEST_SAMPLES = 2 / 3, 128  # share of materials that keep all samples, and the fewest samples of others
# share of the other materials whose samples are noisy, and the greatest standard deviation of a logarithm
NOISY_SHARE, MAX_LOG_NOISE = 1 / 2, 0.1
IN_PLANE_SINE = 0.1  # |sin phi_d| up to which a pair of directions counts as in the plane of incidence
CROWDING_POWER = 3  # the power that crowds theta_h around 0, where highlights are
COLOURED_SHARE = 1 / 2  # share of the materials whose channels are scaled each by its own factor
GRAZING_CUT_SHARE = 1 / 3  # share of the materials that lack grazing samples
MAX_MEASURED_RAD = (math.radians(60), math.radians(85))  # range of the angle beyond which such materials lack samples


def mix_brdfs(tasks: Tasks, rng: Generator) -> Params:
    """Return mixtures of two of these materials each, with channels permuted and scaled.

    Mixing needs both materials at the same angles; where each material of a data set has angles of its own, channels
    are only permuted and scaled.

    Args:
        tasks: T tasks, with `where` and `target`.
        rng: the source of all draws.

    Returns:
        `where` [T, N, 7] and `target` [T, N, 3], where N is AUGMENTED_SAMPLES.
    """
    count, device = len(tasks), rng.device
    where, target = tasks.data["where"], tasks.data["target"]
    sample_rows = torch.randint(where.shape[1], (AUGMENTED_SAMPLES,), generator=rng, device=device)
    reflected = torch.expm1(target[tasks.rows[:, None], sample_rows])
    if where.stride(0) == 0:
        partner_rows = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
        share = 2 * draw_uniform(rng, count, 1, 1)
        reflected = torch.lerp(torch.expm1(target[partner_rows, sample_rows]), reflected, share.clamp(max=1))
    channels = draw_uniform(rng, count, 1, 3).argsort(-1).expand_as(reflected)
    # half of the materials keep the colours of highlights: of most dielectrics they have none
    is_coloured = (draw_uniform(rng, count, 1, 1) < COLOURED_SHARE).float()
    gain = torch.exp(0.3 * is_coloured * draw_normal(rng, count, 1, 3))
    gain = gain * torch.exp(0.3 * draw_normal(rng, count, 1, 1))
    return {
        "where": where[tasks.rows[:, None], sample_rows],
        "target": torch.log1p(reflected.gather(2, channels) * gain),
    }


def is_reachable(where: Tensor, rng: Generator) -> Tensor:
    """Tell which samples an instrument reaches, bool [T, N]: for a share of materials none beyond a random angle.

    Args:
        where: half vector, difference vector and cos theta_i, [T, N, 7].
        rng: the source of all draws.
    """
    least_rad, greatest_rad = MAX_MEASURED_RAD
    chance, share = draw_uniform(rng, len(where), 1), draw_uniform(rng, len(where), 1)
    least_cosine = torch.where(
        chance < GRAZING_CUT_SHARE, torch.cos(least_rad + (greatest_rad - least_rad) * share), 0.0
    )
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= least_cosine


def draw_measurements(
    data: Params, rng: Generator, *, dense_share: float = DENSE_SHARE, counts: tuple[int, int] | None = None
) -> Params:
    """Replace the samples that fits see, the first half, by samples as instruments take them, and add `distinct`, [T].

    Some materials keep dense samples, uniform in half and difference angles. Each of the others has a random count,
    uniform in its logarithm, and one of four patterns: uniform samples, samples scattered as pairs of random directions
    are, samples that crowd around the highlight, and samples in the plane of incidence. An instrument may reach no
    grazing angles (:func:`is_reachable`). Half of the materials that are not dense get noise.

    Args:
        data: `where` [T, N, 7] and `target` [T, N, 3], uniform in half and difference angles.
        rng: the source of all draws.
        dense_share: the share of the materials that keep dense samples.
        counts: the least and the greatest count of samples of the other materials; None: from FEWEST_SAMPLES to N / 2.
    """
    where, target = data["where"].clone(), data["target"].clone()
    tasks, half, device = len(where), where.shape[1] // 2, rng.device
    seen_samples = where[:, :half]
    is_dense, is_reached = draw_uniform(rng, tasks) < dense_share, is_reachable(seen_samples, rng)
    pattern = torch.randint(4, (tasks,), generator=rng, device=device).masked_fill(is_dense, 0)
    density = torch.stack(sample_densities(seen_samples))[pattern, torch.arange(tasks, device=device)] * is_reached
    drawn_rows = torch.multinomial(density + 1e-9, half, replacement=True, generator=rng)
    rows = torch.where(is_dense[:, None] & is_reached, torch.arange(half, device=device), drawn_rows)[..., None]
    is_noisy = (draw_uniform(rng, tasks, 1) < NOISY_SHARE) & ~is_dense[:, None]
    log_noise = torch.where(is_noisy, MAX_LOG_NOISE * draw_uniform(rng, tasks, 1), 0.0)[..., None]
    noise = torch.exp(log_noise * draw_normal(rng, tasks, half, 3))
    where[:, :half] = seen_samples.gather(1, rows.expand(-1, -1, 7))
    target[:, :half] = torch.log1p(torch.expm1(target[:, :half].gather(1, rows.expand(-1, -1, 3))) * noise)
    least, greatest = counts or (FEWEST_SAMPLES, half)
    sample_counts = least * (greatest / least) ** draw_uniform(rng, tasks)
    return {"where": where, "target": target, "distinct": torch.where(is_dense, float(half), sample_counts).round()}


def sample_densities(where: Tensor) -> list[Tensor]:
    """Return densities [T, N] of samples: uniform, scattered, around the highlight, and in the plane of incidence.

    They are relative to samples that are uniform in half and difference angles.

    Args:
        where: half vector, difference vector and cos theta_i of such samples, [T, N, 7].
    """
    theta_h = where[..., 2].clamp(-1, 1).arccos().clamp_min(1e-2)
    # d omega_i d omega_o = 4 cos theta_d d omega_h d omega_d; a surface is seen in proportion to the cosine
    cosines = where[..., 6].clamp_min(0) * outgoing_cosine(where.transpose(1, 2)).clamp_min(0)
    difference_sine = torch.hypot(where[..., 3], where[..., 4])
    scattered = theta_h.sin() * difference_sine * where[..., 5].clamp_min(0) * cosines
    is_in_plane = where[..., 4].abs() <= IN_PLANE_SINE * difference_sine
    return [torch.ones_like(theta_h), scattered, theta_h ** (1 / CROWDING_POWER - 1), is_in_plane.float()]

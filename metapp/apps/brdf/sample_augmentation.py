"""Data augmentation of BRDFs: mixtures of materials, instruments that do not reach grazing angles."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import outgoing_cosine
from metapp.apps.brdf.brdf_network import COUNT_KEY
from metapp.learning.random_tensors import draw_normal, draw_uniform
from metapp.learning.task import Params, Tasks

AUGMENTED_SAMPLES = 8192
DENSE_SHARE, FEWEST_SAMPLES = (
    2 / 3,
    128,
)  # share of the materials with all samples in training, and the fewest of the others
NOISY_SHARE, MAX_LOG_NOISE = (
    1 / 2,
    0.1,
)  # share of the materials whose samples are noisy, and the greatest noise, of a logarithm
IN_PLANE_SINE = 0.1  # |sin phi_d| up to which a pair of directions counts as in the plane of incidence
CROWDING_POWER = 3  # the power that crowds theta_h around 0, where highlights are
COLOURED_SHARE = 1 / 2  # share of the materials whose channels are scaled each by its own factor
GRAZING_CUT_SHARE = 1 / 3  # share of the materials that lack grazing samples
MAX_MEASURED_RAD = (math.radians(60), math.radians(85))  # the least and greatest angle that is measured


def mix_brdfs(tasks: Tasks, rng: Generator) -> Params:
    """Mixtures of two of these materials, channels permuted and scaled: `where`, `target` at SAMPLES samples each.

    Mixing needs both materials at the same angles; if a data set has them at its own for each, they are only
    permuted and scaled.
    """
    count, device = len(tasks), rng.device
    where, target = tasks.data["where"], tasks.data["target"]
    columns = torch.randint(where.shape[1], (AUGMENTED_SAMPLES,), generator=rng, device=device)
    mine = torch.expm1(target[tasks.rows[:, None], columns])
    if where.stride(0) == 0:
        other = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
        share = 2 * draw_uniform(rng, count, 1, 1)
        mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
    channels = draw_uniform(rng, count, 1, 3).argsort(-1).expand_as(mine)
    # half of the materials keep the colours of highlights: of most dielectrics they have none
    coloured = (draw_uniform(rng, count, 1, 1) < COLOURED_SHARE).float()
    gain = torch.exp(0.3 * coloured * draw_normal(rng, count, 1, 3))
    gain = gain * torch.exp(0.3 * draw_normal(rng, count, 1, 1))
    return {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}


def is_reachable(where: Tensor, rng: Generator) -> Tensor:
    """Which samples [T, N, 7] an instrument sees, bool [T, N]: of a share of materials none beyond an angle."""
    low, high = MAX_MEASURED_RAD
    chance, share = draw_uniform(rng, len(where), 1), draw_uniform(rng, len(where), 1)
    limit = torch.where(chance < GRAZING_CUT_SHARE, torch.cos(low + (high - low) * share), 0.0)
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= limit


def draw_measurements(
    data: Params, rng: Generator, *, dense_share: float = DENSE_SHARE, counts: tuple[int, int] | None = None
) -> Params:
    """Replace the samples that fits see, the first half, by ones as instruments take them; add their COUNT [T].

    Some materials keep samples that are dense, uniform in half and difference angles. The others have a count, uniform
    in its logarithm, and a fourth of them each uniform samples, samples scattered as pairs of random directions are,
    samples that crowd around the highlight, and samples in the plane of incidence. An instrument may reach no grazing
    angles (`is_reachable`). Half of the materials that are not dense get noise.

    Args:
        data: `where` [T, N, 7] and `target` [T, N, 3], uniform in half and difference angles.
        rng: the source of all draws.
        dense_share: the share of the materials that keep dense samples.
        counts: the least and the greatest count of the others; None: from FEWEST_SAMPLES to N / 2.
    """
    where, target = data["where"].clone(), data["target"].clone()
    tasks, half, device = len(where), where.shape[1] // 2, rng.device
    seen = where[:, :half]
    dense, reached = draw_uniform(rng, tasks) < dense_share, is_reachable(seen, rng)
    pattern = torch.randint(4, (tasks,), generator=rng, device=device).masked_fill(dense, 0)
    density = torch.stack(sample_densities(seen))[pattern, torch.arange(tasks, device=device)] * reached
    drawn = torch.multinomial(density + 1e-9, half, replacement=True, generator=rng)
    rows = torch.where(dense[:, None] & reached, torch.arange(half, device=device), drawn)[..., None]
    noisy = (draw_uniform(rng, tasks, 1) < NOISY_SHARE) & ~dense[:, None]
    level = torch.where(noisy, MAX_LOG_NOISE * draw_uniform(rng, tasks, 1), 0.0)[..., None]
    noise = torch.exp(level * draw_normal(rng, tasks, half, 3))
    where[:, :half] = seen.gather(1, rows.expand(-1, -1, 7))
    target[:, :half] = torch.log1p(torch.expm1(target[:, :half].gather(1, rows.expand(-1, -1, 3))) * noise)
    least, greatest = counts or (FEWEST_SAMPLES, half)
    fewer = least * (greatest / least) ** draw_uniform(rng, tasks)
    return {"where": where, "target": target, COUNT_KEY: torch.where(dense, float(half), fewer).round()}


def sample_densities(where: Tensor) -> list[Tensor]:
    """Return the densities [T, N] of samples: uniform, scattered, around the highlight, in the plane of incidence.

    They are relative to samples [T, N, 7] that are uniform in half and difference angles.
    """
    polar = where[..., 2].clamp(-1, 1).arccos().clamp_min(1e-2)
    # d omega_i d omega_o = 4 cos theta_d d omega_h d omega_d, and light and viewer see a surface by their cosines
    cosines = where[..., 6].clamp_min(0) * outgoing_cosine(where.transpose(1, 2)).clamp_min(0)
    difference_sine = torch.hypot(where[..., 3], where[..., 4])
    scattered = polar.sin() * difference_sine * where[..., 5].clamp_min(0) * cosines
    in_plane = where[..., 4].abs() <= IN_PLANE_SINE * difference_sine
    return [torch.ones_like(polar), scattered, polar ** (1 / CROWDING_POWER - 1), in_plane.float()]

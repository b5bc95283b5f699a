"""Order in pictures: the lattice on which a texture repeats, its periodic part, and how much of it a picture keeps.

Vectors and frequencies are (y, x), in texels and in cycles per texel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d, pad

HARMONICS = 6  # of each basis frequency
FINEST = 0.4  # cycles per texel of the picture that waves are drawn in: finer ones are left out
SHORTEST, LONGEST = 6.0, 0.36  # of a lattice vector: texels, and sides of the picture
LEAST = 0.08  # correlation of a peak
CANDIDATES = 40  # peaks that bases are sought among
LENGTH = 0.0006 * 256  # what a vector's length, in sides of the picture, takes off its correlation
PARALLEL = 0.4  # least sine of the angle between two basis vectors
ORDERED = (0.1, 0.2)  # scores of lattices that count for nothing, and in full
RIDGE = 1e-3  # of the least squares, in units of one wave
ASTRAY = 0.6  # waves per side of the picture by which a refined basis may differ from the first
MOVED = 2  # texels by which a peak may move and still count as kept


class Lattice(NamedTuple):
    """Where a texture repeats.

    Attributes:
        vectors: [2, 2], the basis, shortest vectors first; the second one 0 where there is one direction alone.
        heights: correlations at these, [2].
        score: of the basis, about 0.3 to 0.9 for walls and weaves and below 0.1 for grass; -1 where there is none.
    """

    vectors: Tensor
    heights: Tensor
    score: float


def waves() -> int:
    """How many waves a periodic part has."""
    return ((2 * HARMONICS + 1) ** 2 - 1) // 2


def harmonics(like: Tensor) -> Tensor:
    """Combinations [K, 2] of the basis frequencies, each wave once: of k and -k the one that is greater."""
    steps = torch.arange(-HARMONICS, HARMONICS + 1, dtype=like.dtype, device=like.device)
    return torch.cartesian_prod(steps, steps)[waves() + 1 :]


def high_passed(image: Tensor, side: int) -> Tensor:
    """Images [..., C, H, W] less the mean of their surroundings, a square of `side` px, an odd number; mean 0."""
    centred = image - image.mean((-1, -2), keepdim=True)
    return centred - _around(centred, side)


def flattened(photos: Tensor) -> Tensor:
    """Photos [..., C, H, W] whose light falls off, as if all places were as bright as the mean."""
    around = _around(photos, min(photos.shape[-2:]) // 4 | 1).clamp_min(0.02)
    return photos * around.mean((-1, -2), keepdim=True) / around


def _around(image: Tensor, side: int) -> Tensor:
    """The mean of the surroundings of each px of images [..., H, W], a square of `side` px, an odd number."""
    border = min(side // 2, min(image.shape[-2:]) - 1)
    padded = pad(image.reshape(-1, 1, *image.shape[-2:]), (border,) * 4, mode="reflect")
    for window in ((2 * border + 1, 1), (1, 2 * border + 1)):
        padded = avg_pool2d(padded, window, stride=1)
    return padded.reshape(image.shape)


def autocorrelation(image: Tensor) -> Tensor:
    """Correlation [2H, 2W] of a picture [C, H, W] with itself, by shift; shift 0, where it is 1, is at [H, W].

    Of what is finer than a quarter of the picture; all channels together; each shift by how much overlaps.
    """
    height, width = image.shape[-2:]
    size = (2 * height, 2 * width)
    fine = high_passed(image, min(height, width) // 4 | 1)
    power = torch.fft.rfft2(fine, s=size).abs().square().sum(0)
    ones = torch.fft.rfft2(torch.ones(height, width, dtype=image.dtype, device=image.device), s=size)
    overlap = torch.fft.irfft2(ones.abs().square(), s=size)
    shifted = torch.fft.irfft2(power, s=size) / overlap.clamp_min(height * width / 9)
    return torch.roll(shifted / shifted[0, 0].clamp_min(1e-12), (height, width), (0, 1))


def lattice_of(image: Tensor) -> Lattice:
    """The lattice of a picture [C, H, W], of at least 16 px a side."""
    image = image.double().cpu()
    correlation = autocorrelation(image)
    found = _basis(_peaks(correlation, image.shape[-2:]), min(image.shape[-2:]))
    vectors, heights = torch.zeros(2, 2, dtype=image.dtype), torch.zeros(2, dtype=image.dtype)
    for i, (height, y, x) in enumerate(found[1]):
        vectors[i], heights[i] = torch.tensor([y, x], dtype=image.dtype), height
    return Lattice(vectors, heights, found[0])


def _peaks(correlation: Tensor, size: torch.Size) -> list[tuple[float, int, int]]:
    """Correlations and shifts (y, x) of the highest local maxima in one half of the plane, highest first."""
    height, width = size
    local = correlation[None, None]
    for window in ((9, 1), (1, 9)):
        local = max_pool2d(local, window, stride=1, padding=(window[0] // 2, window[1] // 2))
    found = []
    for row, column in ((correlation == local[0, 0]) & (correlation > LEAST)).nonzero().tolist():
        y, x = row - height, column - width
        reaches = abs(y) <= LONGEST * height and abs(x) <= LONGEST * width
        if (y, x) > (0, 0) and reaches and math.hypot(y, x) >= SHORTEST:
            found.append((float(correlation[row, column]), y, x))
    return sorted(found, reverse=True)[:CANDIDATES]


def _basis(peaks: list[tuple[float, int, int]], side: int) -> tuple[float, list[tuple[float, int, int]]]:
    """Score and peaks of the best basis: two strong, short, independent ones, or one."""
    best: tuple[float, list[tuple[float, int, int]]] = (-1.0, [])
    for i, (height, y, x) in enumerate(peaks):
        alone = height / 2 - LENGTH * math.hypot(y, x) / side
        best = max(best, (alone, [peaks[i]]))
        for other in peaks[i + 1 :]:
            lengths = math.hypot(y, x), math.hypot(*other[1:])
            if abs(y * other[2] - x * other[1]) >= PARALLEL * math.prod(lengths):
                score = (height + other[0]) / 2 - LENGTH * sum(lengths) / side
                best = max(best, (score, [peaks[i], other]))
    return best


def reduced(vectors: Tensor) -> Tensor:
    """The shortest basis [2, 2] of the same lattice, shorter vector first (Lagrange-Gauss)."""
    first, second = vectors
    while True:
        if float(first.norm()) > float(second.norm()):
            first, second = second, first
        if float(first.norm()) == 0:
            return vectors
        times = torch.round(first @ second / (first @ first))
        if times == 0:
            return torch.stack([first, second])
        second = second - times * first


def frequencies_of(vectors: Tensor) -> Tensor:
    """The basis frequencies [2, 2] of basis vectors [2, 2]: frequency i times vector j is 1 where i = j, else 0."""
    if float(vectors[1].norm()) == 0:
        first = vectors[0] / (vectors[0] @ vectors[0]).clamp_min(1e-12)
        return torch.stack([first, torch.zeros_like(first)])
    inverse: Tensor = torch.linalg.inv(vectors)
    return inverse.T


class Periodic(NamedTuple):
    """The periodic part of pictures: a Fourier series on a lattice.

    Attributes:
        basis: [..., 2, 2], frequencies in cycles per texel.
        waves: [..., K, 2, C], what cosine and sine of each of the `harmonics` are multiplied by.
        strength: [...], 1 where all of the fine picture repeats, 0 where nothing does.
    """

    basis: Tensor
    waves: Tensor
    strength: Tensor


def none_of(*shape: int, channels: int = 3, device: torch.device | None = None) -> Periodic:
    """The periodic part of pictures that have none."""
    parts = (2, 2), (waves(), 2, channels), ()
    return Periodic(*(torch.zeros((*shape, *part), device=device) for part in parts))


def periodic_part(image: Tensor) -> Periodic:
    """The periodic part of a picture [C, H, W], by least squares; 0 where there is no order."""
    lattice = lattice_of(image)
    low, high = ORDERED
    weight = min(max((lattice.score - low) / (high - low), 0.0), 1.0)
    if weight == 0:
        return none_of(channels=image.shape[0])
    fine = high_passed(image.double().cpu(), min(image.shape[-2:]) // 2 | 1)
    two = float(lattice.vectors[1].norm()) > 0
    basis = _refined(fine, frequencies_of(reduced(lattice.vectors) if two else lattice.vectors))
    waves = _series(fine, basis)
    made = drawn(basis, waves, tuple(fine.shape[-2:]))
    share = float(made.var() / fine.var().clamp_min(1e-12)) * _beyond_chance(fine, basis)
    strength = weight * min(1.0, 2 * math.sqrt(share))
    return Periodic(basis.float(), waves.float(), torch.tensor(strength))


def _beyond_chance(fine: Tensor, basis: Tensor) -> float:
    """The part of the energy on a lattice's waves that waves half-way between them, which nothing repeats by, lack."""
    steps = harmonics(basis)
    steps = steps[(steps @ basis).abs().amax(1) <= FINEST - float(basis.abs().max())]
    steps = steps[(steps @ basis).norm(dim=1) > 1e-6]
    on, off = (_energy(_windowed(fine), (steps + shift) @ basis) for shift in (0.0, 0.5))
    return max(0.0, 1 - off / max(on, 1e-12))


def drawn(basis: Tensor, waves: Tensor, size: tuple[int, ...], offset: Tensor | None = None) -> Tensor:
    """Pictures [..., C, H, W] of periodic parts, without waves too fine for them.

    Args:
        basis, waves: as of `Periodic`, with the leading axes of the result.
        size: height and width in texels.
        offset: [..., 2], the texel that the upper left one shows; None: 0.
    """
    frequency = harmonics(basis) @ basis  # [..., K, 2]
    amplitude = torch.complex(waves[..., 0, :], -waves[..., 1, :])  # a cos + b sin = Re (a - ib) e^i
    amplitude = amplitude * (frequency.abs().amax(-1) <= FINEST)[..., None]
    turns = []
    for axis in (0, 1):
        place = torch.arange(size[axis], dtype=basis.dtype, device=basis.device)
        shifted = place if offset is None else place + offset[..., axis, None, None]
        turns.append(torch.exp(2j * math.pi * frequency[..., axis, None] * shifted))  # [..., K, H or W]
    rows = amplitude.mT[..., None] * turns[0][..., None, :, :]  # [..., C, K, H]
    result: Tensor = (rows.mT @ turns[1][..., None, :, :]).real
    return result


def unlike(pictures: Tensor, periodic: Tensor, basis: Tensor) -> Tensor:
    """How far the periodic parts of pictures are from what they should be, relative [...]: 0 alike, 1 without order.

    The squared difference of amplitudes on the lattice's waves over that of the periodic part itself.

    Args:
        pictures: [..., C, H, W].
        periodic: what `drawn` makes of their size, [..., C, H, W].
        basis: [..., 2, 2], in cycles per texel of theirs.
    """
    frequency = harmonics(basis) @ basis
    fine_enough = (frequency.abs().amax(-1) <= FINEST)[..., None]
    height, width = pictures.shape[-2:]
    window = torch.hann_window(height).to(basis)[:, None] * torch.hann_window(width).to(basis)
    turns = [
        torch.exp(-2j * math.pi * frequency[..., axis, None] * torch.arange(size).to(basis))
        for axis, size in enumerate((height, width))
    ]

    def power(differ: Tensor) -> Tensor:
        centred = (differ - differ.mean((-1, -2), keepdim=True)) * window
        across = centred.to(turns[1].dtype) @ turns[1].mT[..., None, :, :]  # [..., C, H, K]
        amplitudes = (across * turns[0].mT[..., None, :, :]).sum(-2)
        result: Tensor = (amplitudes.abs().square().mT * fine_enough).sum((-1, -2))
        return result

    result: Tensor = power(pictures - periodic) / power(periodic).clamp_min(1e-12)
    return result


def snapped(basis: Tensor, size: tuple[int, ...]) -> Tensor:
    """The basis frequencies [..., 2, 2] next to these by which a picture of a size tiles; harmonics stay harmonic."""
    texels = torch.tensor(size, dtype=basis.dtype, device=basis.device)
    return torch.round(basis * texels) / texels


def _series(fine: Tensor, basis: Tensor) -> Tensor:
    """Amplitudes [K, 2, C] of the waves on a lattice, by least squares with a small ridge.

    The normal equations of complex waves are products of geometric sums.
    """
    frequency = harmonics(basis) @ basis
    usable = (frequency.abs().amax(1) <= FINEST) & (frequency.norm(dim=1) > 1e-6)
    both = torch.cat([frequency[usable], -frequency[usable]])
    place = [torch.arange(count, dtype=basis.dtype) for count in fine.shape[-2:]]
    turns = [torch.exp(2j * math.pi * both[:, axis, None] * place[axis]) for axis in (0, 1)]
    products = (turns[0].conj() @ turns[0].T) * (turns[1].conj() @ turns[1].T) / fine[0].numel()
    projected = torch.einsum("ky,cyx,kx->kc", turns[0].conj(), fine.to(turns[0].dtype), turns[1].conj())
    ridge = RIDGE * torch.eye(len(both), dtype=products.dtype)
    solved = torch.linalg.solve(products + ridge, projected / fine[0].numel())[: int(usable.sum())]
    result = torch.zeros(len(frequency), 2, fine.shape[0], dtype=basis.dtype)
    result[usable] = 2 * torch.stack([solved.real, -solved.imag], 1)
    return result


def _windowed(fine: Tensor) -> Tensor:
    """A picture [C, H, W] that fades towards its edges."""
    height, width = fine.shape[-2:]
    return fine.float() * torch.hann_window(height)[:, None] * torch.hann_window(width)


def _energy(seen: Tensor, frequency: Tensor) -> float:
    """How much of a picture [C, H, W] there is at frequencies [K, 2]."""
    height, width = seen.shape[-2:]
    frequency = (2 * math.pi * frequency).float()
    across = torch.arange(width, dtype=torch.float32)[:, None] * frequency[:, 1]
    down = torch.arange(height, dtype=torch.float32)[:, None] * frequency[:, 0]
    real, imaginary = (seen @ part for part in (across.cos(), -across.sin()))  # [C, H, K]
    turn, back = down.cos(), -down.sin()
    parts = (real * turn - imaginary * back).sum(1), (real * back + imaginary * turn).sum(1)
    return float(parts[0].square().sum() + parts[1].square().sum())


def _refined(fine: Tensor, basis: Tensor) -> Tensor:
    """The basis near this one, to a small part of a texel, on whose low harmonics there is most energy."""
    low = harmonics(basis)
    low = low[low.abs().sum(1) <= 3]
    height, width = fine.shape[-2:]
    seen = _windowed(fine)

    def energy(basis: Tensor) -> float:
        return _energy(seen, low @ basis)

    moves = [(i, j) for i in (0, 1) for j in (0, 1) if i == 0 or float(basis[1].norm()) > 0]
    first, best, step = basis, energy(basis), 0.25 / max(height, width)
    while step > 0.01 / max(height, width):
        better = False
        for i, j in moves:
            for sign in (-1, 1):
                moved = basis.clone()
                moved[i, j] += sign * step
                near = float((moved - first).abs().max()) <= ASTRAY / max(height, width)
                if near and (value := energy(moved)) > best:
                    basis, best, better = moved, value, True
        step = step if better else step / 2
    return basis


def order_kept(exemplar: Lattice, made: Tensor) -> float:
    """How much of an exemplar's order a picture [C, H, W] of the same scale keeps.

    The peaks of its autocorrelation at the exemplar's lattice, which may have moved by MOVED texels, over the
    exemplar's: 1 for as much order, 0 for none; NaN where the exemplar has none.
    """
    correlation, (height, width) = autocorrelation(made.double().cpu()), made.shape[-2:]
    kept = []
    for vector, peak in zip(exemplar.vectors, exemplar.heights, strict=True):
        if float(peak) > 0:
            y, x = (round(float(part)) + size for part, size in zip(vector, (height, width), strict=True))
            near = correlation[y - MOVED : y + MOVED + 1, x - MOVED : x + MOVED + 1]
            kept.append(max(0.0, float(near.max() / peak)))
    return sum(kept) / len(kept) if kept and exemplar.score > ORDERED[0] else math.nan

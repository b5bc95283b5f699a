"""Which balls are taken for mirrors: weights and accuracy; `python -m benchmarks.bench_mirror_balls [COUNT]`.

Balls of 70 to 300 px under synthetic maps, developed, with noise, through JPEG: perfect mirrors against matte and
rough ones (metapp.appearance.photograph), and against a sharp coat over a diffuse body. Weights are made under maps of
the training split, errors are those under maps of the test split.
"""

from __future__ import annotations

import io
import sys

import numpy as np
import torch
from PIL import Image
from scipy.optimize import minimize

from data_tools.draws import stream
from data_tools.synthetic.illumination import FAMILIES, environment
from metapp.appearance import photograph as p
from metapp.appearance.colour import srgb_to_linear
from metapp.extensions.capture.ball import mirror
from metapp.extensions.capture.ball.mirror import SIZE, features, looked_at
from metapp.extensions.capture.ball.shots import Shot, disc
from metapp.extensions.capture.ball.view import Ball, mirrored, sampled

KINDS = ("mirror", "matte", "gloss", "coat")
MARGIN = 1.0  # of the logarithm of odds, beyond the most mirror-like of other balls in training


def mirrored_map(light: torch.Tensor, size: int) -> torch.Tensor:
    """A perfect mirror ball [3, size, size] under a map, four samples a px."""
    towards = mirrored(disc(4 * size))
    u = np.arctan2(towards[0], -towards[2]) / (2 * np.pi) % 1
    v = np.arccos(towards[1].clip(-1, 1)) / np.pi
    height, width = light.shape[1:]
    values = sampled(light.numpy().astype(float), np.stack([u * width, v * height]))
    return torch.from_numpy(values.reshape(3, size, 4, size, 4).mean((2, 4))).float()


def photographed(light: torch.Tensor, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Linear RGB [3, SIZE, SIZE] of a ball, as a reader sees it."""
    draw = torch.from_numpy(rng.random((1, 11))).float()
    sharp = mirrored_map(light, SIZE)[None]
    material = p.draw_material(draw[:, :8])
    if kind == "mirror":
        radiance = sharp * (0.5 + 0.5 * draw[:, :3, None, None])
    elif kind == "coat":
        body = p.shade(light[None], material._replace(specular=torch.zeros(1)), SIZE)
        radiance = torch.lerp(body, sharp, float(rng.uniform(0.04, 0.5)))
    else:
        specular = rng.uniform(0.2, 1.0) if kind == "gloss" else rng.choice([0.0, 0.04])
        radiance = p.shade(light[None], material._replace(specular=torch.tensor([float(specular)])), SIZE)
    display = p.develop(radiance, p.draw_camera(draw[:, 8:], radiance)).clamp(0, 1)[0]
    radius = float(rng.uniform(40, 150))
    picture = seen_in(display, radius, rng)
    noise = rng.uniform(0, 0.03) * rng.normal(size=picture.shape)
    image = Image.fromarray(((picture + noise).clip(0, 1) * 255).round().astype(np.uint8).transpose(1, 2, 0))
    buffer = io.BytesIO()
    image.save(buffer, "jpeg", quality=int(rng.integers(60, 96)))
    decoded = np.asarray(Image.open(buffer), np.float64).transpose(2, 0, 1) / 255
    linear = srgb_to_linear(torch.from_numpy(decoded)).numpy().astype(np.float32)
    x, y, r = radius + 8 + 0.01 * radius * rng.normal(size=3)
    return looked_at(Shot(linear, Ball(x, y, r - 8)))


def seen_in(display: torch.Tensor, radius: float, rng: np.random.Generator) -> np.ndarray:
    """A picture in which a ball has this radius, before gray."""
    side = int(2 * radius + 16)
    at = (np.arange(side) + 0.5 - radius - 8) / radius
    x, y = np.meshgrid(at, at)
    shown = sampled(display.numpy().astype(float), np.stack([(x + 1) / 2 * SIZE, (y + 1) / 2 * SIZE]))
    return np.where(np.hypot(x, y) < 1, shown, rng.random())


def drawn(split: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Features [N, 3] and kinds [N]."""
    found, kinds = [], []
    for number in range(count):
        rng = stream(37, 1 if split == "train" else 2, number)
        light = environment(list(FAMILIES.values())[number % len(FAMILIES)], rng, 2, 128)
        light = light / light.mean()
        for index, kind in enumerate(KINDS):
            found.append(features(photographed(light, kind, rng)))
            kinds.append(index)
    return np.array(found), np.array(kinds)


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 96
    values, kinds = drawn("train", count)
    target = kinds == 0
    middle, spread = values.mean(0), values.std(0)
    scaled = (values - middle) / spread

    def loss(weights: np.ndarray) -> float:
        signed = np.where(target, 1, -1) * (scaled @ weights[:3] + weights[3])
        return float(np.logaddexp(0, -signed).mean() + 1e-3 * (weights[:3] ** 2).sum())

    weights = minimize(loss, np.zeros(4)).x
    slopes = weights[:3] / spread
    bias = -float((values[~target] @ slopes).max()) - MARGIN
    print("WEIGHTS", np.round(slopes, 3).tolist(), "BIAS", round(bias, 3))
    for name, (some, of) in {"train": (values, kinds), "test": drawn("test", count)}.items():
        for weights_, bias_, what in ((slopes, bias, "made now"), (mirror.WEIGHTS, mirror.BIAS, "in use")):
            taken = some @ np.array(weights_) + bias_ > 0
            print(name, what, {kind: f"{taken[of == i].mean():.3f}" for i, kind in enumerate(KINDS)}, (of == 0).sum())
        print(name, {kind: np.round(some[of == i].mean(0), 2).tolist() for i, kind in enumerate(KINDS)})


if __name__ == "__main__":
    main()

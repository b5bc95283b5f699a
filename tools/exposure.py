"""What wrong exposures cost maps of one flash photo, and what estimates of them gain: exposure.py DRAWN DATA...

The test photos of each data set a stop darker, as they are, and a stop brighter, read by General of recipe full at 64
texels. Mean errors without a correction, with the stops told, as --exposure does it, and with estimated ones:

- mean: the log mean of the photo's central part differs by so much from that of DRAWN's photos;
- regressed: by linear regression on that mean;
- encoder: by ridge regression on means and deviations of features of General's encoder; also only if above a stop;
- highlight: where one is clear, it is as high as an F0 of 0.04 makes it.

Then with what is best for each photo of five exposures from -2 to 2 stops, which takes the truth to know; and the
standard deviation of estimates' errors. Regressions are trained on materials of DRAWN (`metapp data synth
svbrdf_nonstationary --count 100 --seed 35 --size 256 --out DRAWN`), varied, exposed by -2 to 2 stops.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d

from data_tools.readers.svbrdf_task import encoded, rightly_exposed
from metapp.appearance.flash import BESIDE_LENS, Maps, camera_distance, expose, flash_position, unpack
from metapp.appearance.highlight import gloss
from metapp.apps.svbrdf_nonstationary.app import JUDGED, SvbrdfNonstationary, _pairs
from metapp.apps.svbrdf_nonstationary.encoder import _block
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, inputs_of, linear, photographed, pooled
from metapp.apps.svbrdf_nonstationary.variants import JITTER, varied
from metapp.learning.task import Params, Task
from metapp.networks.coded import reader_of
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.plan import Plan, plan
from metapp.runs.request import Request
from metapp.storage.shards import read_shard

NAME, SIDE, AT = "svbrdf_nonstationary", 64, (-1.0, 0.0, 1.0)
PENALTY, DRAWS, FOLDS, MOST = 300.0, 10, 5, 2.0
F0, CLEAR, ROUGH = 0.04, 0.5, (0.15, 0.6)  # of a highlight that says how bright a photo is
Estimate = Callable[[Tensor], Tensor]  # of photos uint8 [T, 3, S, S] in stops, [T]


def general() -> Plan:
    """General of recipe full, for maps of SIDE texels."""
    found = find_checkpoint(plan(Request(NAME, "general", observe="photo", recipe="full", device="cpu", quiet=True)))
    field = found.app.setup.field._replace(height=SIDE, width=SIDE, rows=SIDE, columns=SIDE)
    app = replace(found.app, setup=replace(found.app.setup, field=field))
    return replace(found, job=found.job._replace(app=app))


def tasks_in(folder: Path, split: str) -> list[Task]:
    """Of one split of a data set."""
    return read_shard(folder, split, NAME, SvbrdfNonstationary.holds)


@torch.no_grad()
def errors(by: Plan, photos: Tensor, true: Tensor) -> Tensor:
    """Of General's maps of photos [T, 3, S, S], [T]; `true` are the logs of what is right, as of `judged`."""
    small = adaptive_avg_pool2d(linear(photos), SIDE)
    theta = by.app.encode(by.prepared.encoder, {"photo": small})
    return (judged(by, by.app.maps_of(theta, small)) - true).abs().mean((1, 2, 3, 4))


def judged(by: Plan, maps: Maps) -> Tensor:
    """Logs of what maps [T, ...] send out under the lights of tables."""
    logs: Tensor = by.app._logs(maps, _pairs(JUDGED)[None])
    return logs


def exposed(photos: Tensor, stops: Tensor) -> Tensor:
    """Photos that are brighter by so many stops, [T] or [1]."""
    return encoded((linear(photos) * 2.0 ** stops[:, None, None, None]).clamp(0, 1))


def corrected(photos: Tensor, stops: Tensor) -> Tensor:
    """Photos as if they were too bright by so many stops, [T]."""
    return torch.stack([rightly_exposed(photo, float(each)) for photo, each in zip(photos, stops, strict=True)])


def log_mean(photos: Tensor) -> Tensor:
    """Of the central part, in stops, [T]."""
    middle = adaptive_avg_pool2d(linear(photos), SIDE)[..., SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4]
    return (middle + 0.008).log2().mean((1, 2, 3))


@torch.no_grad()
def features(by: Plan, photos: Tensor) -> Tensor:
    """Log mean, and means and deviations of features of the encoder's levels of 16, 8 and 4 texels, [T, F]."""
    encoder: Params = reader_of(by.prepared.encoder)
    x, found = inputs_of(adaptive_avg_pool2d(linear(photos), SIDE)), [log_mean(photos)[:, None]]
    for level in range(by.app.setup.encoder.levels):
        x = _block(encoder, f"down{level}", avg_pool2d(x, 2) if level else x)
        found += [x.mean((2, 3)), x.std((2, 3))] if level >= 2 else []
    return torch.cat(found, 1)


def ridge(x: Tensor, y: Tensor, penalty: float) -> Estimate:
    """Ridge regression of stops y [N] on features x [N, F]: a function of others."""
    mean, deviation = x.mean(0), x.std(0) + 1e-4

    def inputs(rows: Tensor) -> Tensor:
        return torch.cat([(rows - mean) / deviation, torch.ones(len(rows), 1)], 1).double()

    a = inputs(x)
    penalties = penalty * torch.eye(a.shape[1], dtype=torch.float64)
    penalties[-1, -1] = 0
    weights = torch.linalg.solve(a.mT @ a + penalties, a.mT @ y.double())
    return lambda rows: (inputs(rows) @ weights).float()


@torch.no_grad()
def by_highlight(photos: Tensor) -> Tensor:
    """Where a highlight is clear, by how many stops it is higher than F0 makes it; else 0; [T]."""
    shown = adaptive_avg_pool2d(linear(photos), 2 * SIDE)
    place = flash_position(expose(shown))
    found = gloss(expose(shown), torch.cat([place, torch.full_like(place[:, :1], camera_distance())], 1))
    clear = (found.contrast > CLEAR) & (found.roughness > ROUGH[0]) & (found.roughness < ROUGH[1])
    return (found.specular / F0).clamp(2**-MOST, 2**MOST).log2() * clear


def calibrated(maps: Tensor, rng: Generator) -> Tensor:
    """Radiance of maps [T, 10, S, S] under drawn flashes, [T, 3, S, S]."""
    beside = torch.rand(len(maps), 1, generator=rng) < BESIDE_LENS
    drawn = torch.randn(len(maps), FLASH, generator=rng) * torch.tensor(JITTER) * ~beside
    return photographed(unpack(maps), flash_of(drawn))


def estimates(by: Plan, drawn: list[Task]) -> dict[str, Estimate]:
    """By name; says how well those that are trained estimate materials that they do not know."""
    rng, x, y = Generator().manual_seed(1), [], []
    maps = torch.stack([task.data["maps"] for task in drawn]).float()
    for _ in range(DRAWS):
        radiance = calibrated(varied(maps, maps.shape[-1] // 2, rng), rng)
        y.append(2 * MOST * torch.rand(len(drawn), generator=rng) - MOST)
        x.append(features(by, encoded(radiance * 2.0 ** y[-1][:, None, None, None])))
    rows, stops, known = torch.cat(x), torch.cat(y), torch.arange(len(drawn)).repeat(DRAWS) % FOLDS
    for name, columns in (("regressed", 1), ("encoder", rows.shape[1])):
        off = []
        for fold in range(FOLDS):
            seen = known != fold
            off.append(ridge(rows[seen, :columns], stops[seen], PENALTY)(rows[~seen, :columns]) - stops[~seen])
        print(f"{name}: {float(torch.cat(off).square().mean().sqrt()):.2f} stops off (RMSE) on drawn materials")
    line, by_encoder = ridge(rows[:, :1], stops, 0.0), ridge(rows, stops, PENALTY)
    usual = float((rows[:, 0] - stops).mean())

    def above(photos: Tensor) -> Tensor:
        found = by_encoder(features(by, photos))
        return found * (found.abs() > 1)

    return {
        "mean": lambda photos: log_mean(photos) - usual,
        "regressed": lambda photos: line(log_mean(photos)[:, None]),
        "encoder": lambda photos: by_encoder(features(by, photos)),
        "encoder, above 1": above,
        "highlight": by_highlight,
    }


def main(drawn: Path, folders: list[Path]) -> None:
    """Print a table for each data set."""
    by = general()
    ways = estimates(by, tasks_in(drawn, "train"))
    for folder in folders:
        tasks = tasks_in(folder, "test")
        photos = torch.stack([task.data["photo"] for task in tasks])
        wanted = judged(by, unpack(torch.stack([pooled(task.data["maps"].float(), (SIDE, SIDE)) for task in tasks])))
        albedo = torch.stack([unpack(task.data["maps"].float()).diffuse.mean() for task in tasks])
        spread = float((albedo + 1e-3).log2().std())
        print(f"\n{folder.name}: {len(tasks)} materials, mean albedo varies by {spread:.2f} stops (deviation)")
        print("| correction | " + " | ".join(f"{stops:+.0f}: error, stops off" for stops in AT) + " |", flush=True)
        cells: dict[str, list[str]] = {}
        for stops in AT:
            shown, true = exposed(photos, torch.tensor([stops])), torch.full((len(tasks),), stops)
            guesses = {"none": 0 * true, "told": true} | {name: way(shown) for name, way in ways.items()}
            for name, guess in guesses.items():
                error = float(errors(by, corrected(shown, guess.clamp(-MOST, MOST)), wanted).mean())
                cells.setdefault(name, []).append(f"{error:.3f}, {float((guess - true).square().mean().sqrt()):.2f}")
            choices = torch.linspace(-MOST, MOST, 5)
            best = torch.stack([errors(by, corrected(shown, each.expand(len(tasks))), wanted) for each in choices])
            cells.setdefault("best of five", []).append(f"{float(best.amin(0).mean()):.3f}")
        for name, row in cells.items():
            print(f"| {name} | " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    first, *others = map(Path, sys.argv[1:])
    main(first, others)

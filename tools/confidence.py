"""Train what tells how sure fits of photographs of light are: confidence.py [OUT], two minutes.

Fits by the checkpoints of illumination that ship, General, QuickFT and Meta by photo, of drawn maps that none of them
was trained on: augmented, and first brought to the power of 1 to HARDEST, as real rooms have more contrast than drawn
ones. The network is written to OUT, else to where it ships; its coverage of other fits is printed.
`python -m benchmarks.bench_confidence` judges it.
"""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Generator, Tensor

from data_tools.synthetic.illumination import synthetic_tasks
from metapp.apps.illumination.app import READ, Illumination
from metapp.apps.illumination.confidence import covered, init, off_by, predicted, shipped
from metapp.apps.illumination.variants import of_mean_1
from metapp.learning.app import stack
from metapp.learning.task import Params, Tasks
from metapp.runs.checkpoints.finding import find_checkpoint
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.storage.files import write_atomically

PARADIGMS = ("general", "quickft", "meta")
SEED = 37  # of draws that no checkpoint has seen
HARDEST = 1.8
MAPS, BESIDE = {"quick": 320, "full": 16}, 8  # maps by recipe; fits side by side
STEPS, RATE, FITS, TEXELS = 600, 2e-2, 64, 128
CHECKED = 1 / 5  # of the maps, the last ones

Pairs = tuple[Tensor, Tensor]
"""Features [N, ROWS, COLUMNS, F] of fits, and how far these are off, [N, ROWS, COLUMNS]."""


def fits_of(recipe: str, count: int) -> Pairs:
    """Features and differences of all paradigms' fits, task by task."""
    requests = (Request("illumination", name, observe="photo", recipe=recipe, quiet=True) for name in PARADIGMS)
    plans = [find_checkpoint(plan(each)) for each in requests]
    app = plans[0].app
    assert isinstance(app, Illumination)
    found: list[Pairs] = []
    for tasks in drawn_tasks(app, count):
        for each in plans:
            theta = each.paradigm.fit(each.job, each.prepared, tasks, Generator().manual_seed(SEED))
            with torch.no_grad():
                made = app.answer(theta, tasks.data)
                found.append((app.read_off(theta, tasks.data), off_by(made, tasks.data["map"])))
        print(f"{recipe}: {len(found) // len(plans) * BESIDE} of {count} maps", file=sys.stderr, flush=True)
    return torch.cat([read for read, _ in found]), torch.cat([off for _, off in found])


def drawn_tasks(app: Illumination, count: int) -> Iterator[Tasks]:
    """Augmented drawn maps with photographs, BESIDE at a time."""
    tasks = stack(app, list(synthetic_tasks("train", count, SEED, max(READ, app.field.height))))
    rng = Generator().manual_seed(SEED)
    powers = 1 + (HARDEST - 1) * torch.rand(count, 1, 1, 1, generator=rng)
    tasks = replace(tasks, data=tasks.data | {"map": of_mean_1(tasks.data["map"] ** powers)})
    for first in range(0, count, BESIDE):
        yield app.augment(tasks.select(range(first, min(first + BESIDE, count))), rng)


def trained(read: Tensor, off: Tensor) -> Params:
    """The network, by maximum likelihood; texels count by their solid angle, as they are drawn by it."""
    rng = Generator().manual_seed(0)
    params = init(rng, read)
    learned = [value.requires_grad_() for key, value in params.items() if key.startswith("layer")]
    optimiser = torch.optim.Adam(learned, RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, STEPS)
    rows, columns = off.shape[1:]
    weights = torch.sin((torch.arange(rows) + 0.5) * (torch.pi / rows)).repeat_interleave(columns)
    for _ in range(STEPS):
        fits = torch.randint(len(off), (FITS, 1), generator=rng)
        texels = torch.multinomial(weights, TEXELS, True, generator=rng)
        surprise = predicted(params, read.flatten(1, 2)[fits, texels]).surprise(off.flatten(1)[fits, texels])
        optimiser.zero_grad()
        surprise.mean().backward()
        optimiser.step()
        schedule.step()
    return {key: value.detach() for key, value in params.items()}


def main() -> None:
    """Fit, train, check, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, nargs="?", default=shipped())
    options = parser.parse_args()
    torch.set_num_threads(1)
    used: list[Pairs] = []
    kept: dict[str, Pairs] = {}
    for recipe, count in MAPS.items():
        read, off = fits_of(recipe, count)
        middle = len(off) - round(CHECKED * len(off))
        used.append((read[:middle], off[:middle]))
        kept[recipe] = read[middle:], off[middle:]
    params = trained(torch.cat([read for read, _ in used]), torch.cat([off for _, off in used]))
    for recipe, (read, off) in kept.items():
        spread = predicted(params, read)
        parts = [f"{float(covered(spread, off, share).mean()):.1%} of {share:.0%}" for share in (0.5, 0.9)]
        print(f"{recipe}, {len(off)} fits of other maps: intervals hold {', '.join(parts)}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, functools.partial(save_file, params))
    print(options.out, options.out.stat().st_size)


if __name__ == "__main__":
    main()

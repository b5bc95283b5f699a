"""Train the guide prior that ships, on random rooms: guide_prior.py DATA OUT [--rooms 40].

DATA keeps what rooms' caches know, 7 s a room; those that are there are not made again. General, QuickFT and Meta are
trained on it, and compared on rooms that no training saw. OUT gets their checkpoints; `ship.py` makes those that ship.
"""

from __future__ import annotations

import argparse
import functools
import sys
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Generator, Tensor

from data_tools.synthetic.guiding import NAMES, guide_tasks
from data_tools.synthetic.rooms import KINDS
from metapp.apps.transport.guiding import APP, RECIPE
from metapp.learning.app import stack
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Task, Tasks
from metapp.paradigms import Job, paradigms
from metapp.paradigms.paradigm import Given
from metapp.rendering.guide_prior import init
from metapp.storage.files import write_atomically
from metapp.storage.records import save_checkpoint, tensor_digest

TRAIN, VALIDATE, TEST = 2000, 3000, 4000  # first seeds
FEW = 4  # rooms of a kind that validate, and that test


def rooms(folder: Path, first: int, count: int) -> Tasks:
    """Tasks of `count` rooms of each kind, made where they are missing."""
    tasks = []
    for seed in range(first, first + count):
        for kind in KINDS:
            file = folder / f"{kind}-{seed}.safetensors"
            if not file.exists():
                made = {
                    f"{task.name}/{key}": value for task in guide_tasks(kind, seed) for key, value in task.data.items()
                }
                write_atomically(file, functools.partial(save_file, made))
                print(file, file=sys.stderr, flush=True)
            held = load_file(file)
            for name in NAMES:
                task = f"{kind}-{seed}-{name}"
                tasks.append(Task(task, {key: held[f"{task}/{key}"] for key in APP.holds}, f"{kind}-{seed}"))
    return stack(APP, tasks)


def variances(prepared: MetaParameters, paradigm: str, rule: str, tasks: Tasks) -> Tensor:
    """The error of each task."""
    fits = []
    for part in torch.arange(len(tasks)).split(8):
        some = tasks.select(part.tolist())
        theta = paradigms()[paradigm].fit(Job(APP, RECIPE, rule), prepared, some, Generator().manual_seed(0))
        fits.append(APP.errors(theta, some)["error"])
    return torch.cat(fits)


def interval(differences: Tensor) -> str:
    """Mean over rooms of a difference of logarithms of noise, as a ratio with a 95 % interval by bootstrap."""
    drawn = np.random.default_rng(0).integers(len(differences), size=(10_000, len(differences)))
    means = differences.numpy()[drawn].mean(1)
    low, high = np.exp(np.percentile(means, (2.5, 97.5)) / 2)
    return f"{float((differences.mean() / 2).exp()):.3f} [{low:.3f}, {high:.3f}]"


def compare(found: dict[str, tuple[MetaParameters, str, str]], tasks: Tasks) -> None:
    """Print a table: noise over that of a cache that expects nothing, by how many paths taught it."""
    untrained = MetaParameters(encoder=init(Generator()))
    without = variances(untrained, "general", RECIPE.rule, tasks).reshape(-1, len(NAMES))
    general = variances(found["general"][0], "general", RECIPE.rule, tasks).reshape(-1, len(NAMES))
    print("| noise over that without a prior | " + " | ".join(NAMES) + " | over General | lower in rooms |")
    print("|---" * (len(NAMES) + 3) + "|")
    for name, (prepared, paradigm, rule) in found.items():
        errors = variances(prepared, paradigm, rule, tasks).reshape(-1, len(NAMES))
        cells = [interval(errors[:, i] - without[:, i]) for i in range(len(NAMES))]
        lower = int((errors < without).all(1).sum())
        beside = interval((errors - general).mean(1))
        print(f"| {name} | " + " | ".join(cells) + f" | {beside} | {lower} of {len(errors)} |", flush=True)


def main() -> None:
    """Train, write, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rooms", type=int, default=40, help="of each kind, that train")
    options = parser.parse_args()
    for folder in (options.data, options.out):
        folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    validating = rooms(options.data, VALIDATE, FEW)
    training = rooms(options.data, TRAIN, options.rooms)
    found: dict[str, tuple[MetaParameters, str, str]] = {}
    encoder = None
    for name, paradigm, rule in (
        ("general", "general", RECIPE.rule),
        ("quickft", "quickft", RECIPE.rule),
        *((rule, "meta", rule) for rule in RECIPE.meta),
    ):

        def report(step: int, steps: int, note: str, name: str = name) -> None:
            print(f"{name}: {step}/{steps} {note}", file=sys.stderr, flush=True)

        given = Given(training, validating, Generator().manual_seed(0), encoder, report=report)
        prepared = paradigms()[paradigm].prepare(Job(APP, RECIPE, rule), given)
        encoder = encoder or prepared.start
        found[name] = (prepared.start, paradigm, rule)
        info = {
            "app": APP.name,
            "start": name,
            "recipe": "quick",
            "data": f"rooms, {options.rooms} of each kind from seed {TRAIN}",
            "validation_error": prepared.validation,
            "encoder": tensor_digest(encoder.encoder),
        }
        save_checkpoint(options.out / f"{name}.safetensors", prepared.start, info)
    compare(found, rooms(options.data, TEST, FEW))


if __name__ == "__main__":
    main()

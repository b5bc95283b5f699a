"""Train the guide prior that ships, on random rooms: guide_prior.py DATA OUT [--rooms 40].

DATA keeps the tasks of rooms, 7 s a room; those that are there are not made again. General, QuickFT and Meta are
trained on them, and compared on rooms of no training. OUT gets their checkpoints; `ship.py` makes those that ship.
"""

from __future__ import annotations

import argparse
import functools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from guide_prior_problem import APP, RECIPE
from guide_prior_tasks import NAMES, guide_tasks
from safetensors.torch import load_file, save_file
from torch import Generator, Tensor

from data_tools.synthetic.rooms import KINDS, random_room
from metapp.extensions.guided import equal_time
from metapp.extensions.guided.integrator import RR_DEPTH
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.picture import GuidedPicture
from metapp.extensions.guided.prior import init
from metapp.learning.app import stack
from metapp.learning.learn import MetaParameters
from metapp.learning.progress import Prepared, Progress
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms import Job, paradigms
from metapp.paradigms.paradigm import TrainingData
from metapp.rendering.paths.path_space import DEPTH
from metapp.rendering.scenes.loading import load_scene
from metapp.storage.files import write_atomically
from metapp.storage.records import load_checkpoint, save_checkpoint

TRAIN, VALIDATE, TEST = 2000, 3000, 4000  # first seeds
FEW = 4  # rooms of a kind that validate, and that test
PICTURES = 6  # of a room and method

Trained = tuple[MetaParameters, str, str]
"""With the names of paradigm and rule."""


def room_tasks(folder: Path, first: int, count: int) -> Tasks:
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


def compare(trained: dict[str, Trained], tasks: Tasks) -> None:
    """Print a table: noise over that of a cache without a prior, by how many paths it has learned from."""
    untrained = MetaParameters(encoder=init(Generator()))
    without = variances(untrained, "general", RECIPE.rule, tasks).reshape(-1, len(NAMES))
    general = variances(trained["general"][0], "general", RECIPE.rule, tasks).reshape(-1, len(NAMES))
    print("| noise over that without a prior | " + " | ".join(NAMES) + " | over General | lower in rooms |")
    print("|---" * (len(NAMES) + 3) + "|")
    for name, (prepared, paradigm, rule) in trained.items():
        errors = variances(prepared, paradigm, rule, tasks).reshape(-1, len(NAMES))
        cells = [interval(errors[:, i] - without[:, i]) for i in range(len(NAMES))]
        lower = int((errors < without).all(1).sum())
        beside = interval((errors - general).mean(1))
        print(f"| {name} | " + " | ".join(cells) + f" | {beside} | {lower} of {len(errors)} |", flush=True)


def pictures(theta: Params, size: int, spp: int) -> str:
    """Noise of pictures with a prior over that without, in as many samples, a line of a table."""
    ratios = []
    for seed in range(TEST, TEST + FEW):
        for kind in KINDS:
            mi, scene, _ = load_scene(random_room(kind, seed))
            equal_time.resize(scene, size)
            noise = [_noise(mi, scene, spp, prior) for prior in (theta, None)]
            ratios.append(noise[0] / noise[1])
    lower = sum(ratio < 1 for ratio in ratios)
    return f"| {size} | {spp} | {interval(2 * torch.tensor(ratios).log())} | {lower} of {len(ratios)} |"


def _noise(mi: Any, scene: Any, spp: int, prior: Params | None) -> float:
    """Mean over pixels of how far pictures of several seeds are from each other, relative to their mean."""
    tracer, path = PathTracer(DEPTH, RR_DEPTH), mi.load_dict({"type": "path"})
    film = scene.sensors()[0].film()
    made: list[Tensor] = []
    for seed in range(PICTURES):
        picture = GuidedPicture(path, tracer, scene, scene.sensors()[0], seed, prior)
        picture.render(spp)
        made.append(torch.from_numpy(film.develop().numpy())[..., :3].mean(2))
    mean = torch.stack(made).mean(0)
    halves = zip(made[::2], made[1::2], strict=True)
    return float(torch.stack([((first - second).abs() / (mean + 1e-3)).mean() for first, second in halves]).mean())


def prepared_by(name: str, preparation: Iterator[Progress]) -> Prepared:
    """The result of a preparation, whose validations are printed."""
    prepared = None
    for now in preparation:
        prepared = now.best
        if now.note:
            print(f"{name}: {now.done}/{now.total} {now.note}", file=sys.stderr, flush=True)
    assert prepared is not None
    return prepared


def train(folder: Path, training: Tasks, validating: Tasks, data: str) -> dict[str, Trained]:
    """General, QuickFT and Meta by their checkpoints in a folder, trained where these are missing."""
    trained: dict[str, Trained] = {}
    encoder = None
    for name, paradigm in (("general", "general"), ("quickft", "quickft"), *((rule, "meta") for rule in RECIPE.meta)):
        rule = name if paradigm == "meta" else RECIPE.rule

        def report(step: int, steps: int, note: str, name: str = name) -> None:
            print(f"{name}: {step}/{steps} {note}", file=sys.stderr, flush=True)

        file = folder / f"{name}.safetensors"
        if not file.exists():
            material = TrainingData(training, validating, Generator().manual_seed(0), encoder)
            prepared = prepared_by(name, paradigms()[paradigm].prepare(Job(APP, RECIPE, rule), material))
            info = {"app": APP.name, "checkpoint": name, "recipe": "quick", "data": data}
            save_checkpoint(file, prepared.phi, info | {"validation_error": prepared.validation})
        phi, _ = load_checkpoint(file)
        encoder = encoder or phi
        trained[name] = (phi, paradigm, rule)
    return trained


def main() -> None:
    """Train, write, compare; what is in OUT is not trained again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--rooms", type=int, default=40, help="of each kind, that train")
    options = parser.parse_args()
    for folder in (options.data, options.out):
        folder.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    validating = room_tasks(options.data, VALIDATE, FEW)
    training = room_tasks(options.data, TRAIN, options.rooms)
    trained = train(options.out, training, validating, f"rooms, {options.rooms} of each kind from seed {TRAIN}")
    compare(trained, room_tasks(options.data, TEST, FEW))
    print("| px a side | samples a pixel | noise of pictures, over that without a prior | lower in rooms |")
    print("|---|---|---|---|")
    for size, spp in ((64, 4), (64, 16), (64, 64), (256, 4), (256, 16), (256, 64)):
        print(pictures(trained["general"][0].encoder, size, spp), flush=True)


if __name__ == "__main__":
    main()

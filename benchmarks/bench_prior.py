"""Does the learned prior of `guided_path` pay? Error of pictures of few samples with it over that without.

Of equal samples, the survey left out of them, by the same cache. Scenes are those of `bench_guiding`, scene files of
Mitsuba 3, and random rooms, such as "board 4000". References are kept in a folder,
and rows of earlier runs.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.bench_guiding import Bench, box_filtered
from benchmarks.guiding_scenes import scenes
from data_tools.synthetic.rooms import KINDS, random_room
from metapp.extensions.guided.integrator import RR_DEPTH
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.picture import GuidedPicture
from metapp.extensions.guided.prior import read_prior, shipped
from metapp.extensions.scene_files.reading import read_scene
from metapp.learning.task import Params
from metapp.rendering.paths.path_space import DEPTH

NONE = "none"


class Scene(Bench):
    """A scene and its reference; no speeds."""

    def _first(self, name: str) -> tuple[float, float]:
        return 0.0, 1.0


def known(name: str) -> tuple[str, Any]:
    """A scene by its name or file."""
    kind, _, seed = name.rpartition(" ")
    if kind in KINDS and kind != "box":
        return name, random_room(kind, int(seed))
    if name in scenes():
        return name, scenes()[name]
    return Path(name).parent.name, box_filtered(read_scene(Path(name)))


def made(bench: Scene, spp: int, seed: int, prior: Params | None) -> tuple[Tensor, float]:
    """A guided picture, however few its samples are, and its seconds of CPU."""
    begin, sensor = time.process_time(), bench.scene.sensors()[0]
    tracer = PathTracer(DEPTH, RR_DEPTH)
    picture = GuidedPicture(bench.path, tracer, bench.scene, sensor, seed, prior)
    picture.render(spp)
    return torch.from_numpy(sensor.film().develop().numpy())[..., :3].clone(), time.process_time() - begin


def measure(name: str, options: argparse.Namespace, priors: dict[str, Params | None]) -> list[dict[str, Any]]:
    """Errors and seconds of a scene's pictures."""
    options.known = dict([known(name)])
    name = next(iter(options.known))
    bench = Scene(name, options)
    rows = []
    for spp in options.spp:
        made(bench, spp, 0, priors[NONE])  # compiles
        for seed in range(1, options.seeds + 1):
            for prior, theta in priors.items():
                picture, seconds = made(bench, spp, seed, theta)
                row = {"scene": name, "spp": spp, "seed": seed, "prior": prior, "error": bench.error(picture)}
                rows.append(row | {"seconds": seconds, "own": bench.own_error})
    return rows


def interval(logs: list[float]) -> str:
    """The mean of logarithms of ratios as a ratio, with a 95 % interval by bootstrap."""
    drawn = np.random.default_rng(0).integers(len(logs), size=(10_000, len(logs)))
    low, high = np.exp(np.percentile(np.array(logs)[drawn].mean(1), (2.5, 97.5)))
    return f"{math.exp(statistics.fmean(logs)):.3f} [{low:.3f}, {high:.3f}]"


def table(rows: list[dict[str, Any]], prior: str) -> str:
    """Errors with a prior over those without, means over seeds, then over scenes, as markdown."""
    errors = {(row["scene"], row["spp"], row["seed"], row["prior"]): row["error"] for row in rows}
    logs: dict[tuple[str, int], list[float]] = {}
    for (name, spp, seed, which), error in errors.items():
        if which == prior:
            logs.setdefault((name, spp), []).append(math.log(error / errors[name, spp, seed, NONE]))
    names, samples = list(dict.fromkeys(key[0] for key in logs)), list(dict.fromkeys(key[1] for key in logs))
    lines = [f"| {prior} over none | " + " | ".join(f"{spp} spp" for spp in samples) + " |"]
    lines.append("|---" * (len(samples) + 1) + "|")
    for name in names:
        cells = (interval(logs[name, spp]) if (name, spp) in logs else "" for spp in samples)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    means = [[statistics.fmean(values) for key, values in logs.items() if key[1] == spp] for spp in samples]
    lines.append("| all | " + " | ".join(interval(values) for values in means) + " |")
    ahead = (f"{sum(value < 0 for value in values)} of {len(values)}" for values in means)
    return "\n".join([*lines, "| ahead | " + " | ".join(ahead) + " |"])


def main() -> None:
    """Measure, and print a table of each prior."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="px along the longer side")
    parser.add_argument("--reference", type=int, default=2048, help="samples a pixel of the reference")
    parser.add_argument("--spp", type=int, nargs="+", default=[1, 4, 16], help="samples a pixel")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--priors", type=Path, nargs="+", default=[shipped()], help="checkpoints")
    parser.add_argument("--scenes", nargs="+", default=list(scenes()), help="names, or scene files of Mitsuba 3")
    parser.add_argument("--out", type=Path, default=Path("runs/guiding"))
    options = parser.parse_args()
    options.methods = []
    options.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    priors = {NONE: None} | {file.stem: read_prior(file) for file in options.priors}
    file = options.out / "prior.jsonl"
    rows = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    with file.open("a", encoding="utf-8") as out:
        for name in options.scenes:
            new = measure(name, options, priors)
            rows += new
            out.writelines(json.dumps(row) + "\n" for row in new)
            out.flush()
    for prior in priors:
        if prior != NONE:
            print(table(rows, prior), flush=True)


if __name__ == "__main__":
    main()

"""Error over seconds of guided and regular paths, in equal total time: `make guiding`.

Each picture is made anew for its time, with everything counted: for guided ones also what is learned, for both loading
of the integrator and the film. The code that Dr.Jit compiles once is not. Times are CPU seconds of the process, so that
other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import statistics
import time
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import metapp.mitsuba  # noqa: F401  (registers guided_path)
from metapp.appearance.metrics import mape
from metapp.rendering import equal_time
from metapp.rendering.path_space import DEPTH
from metapp.rendering.scene_loading import load_scene
from tests.benchmarks.guiding_scenes import kind_of, scenes

METHODS = {"regular + NEE": None, "guided + NEE": True, "guided": False}
WARM = 48  # samples a pixel by which code is compiled and speeds are first known
NEAR = 0.1  # of the seconds
KINDS = ("boxes", "baffle", "caustic")


class Bench:
    """One scene.

    Args:
        scene: as `load_scene` takes it.
        size: side of the pictures, px.
        reference: samples a pixel of the reference.
    """

    def __init__(self, scene: dict[str, Any], size: int, reference: int) -> None:
        self.mi, self.scene, _ = load_scene(scene)
        equal_time.resize(self.mi, self.scene, size)
        self.path = self.mi.load_dict({"type": "path", "max_depth": DEPTH})
        waves = 2 * max(1, reference // 1024)
        made = [
            equal_time.rendered(self.mi, self.scene, self.path, reference // waves, 10**6 + i) for i in range(waves)
        ]
        halves = [torch.stack(made[i::2]).mean(0) for i in (0, 1)]
        self.reference = (halves[0] + halves[1]) / 2
        self.own_error = self.error(halves[0])  # a half is as far from the mean as that is from the truth
        self.costs = {name: self._first(joins) for name, joins in METHODS.items()}

    def error(self, picture: Tensor) -> float:
        """MAPE."""
        return float(mape(picture.permute(2, 0, 1)[None], self.reference.permute(2, 0, 1)[None]))

    def measured(self, name: str, seconds: float, seed: int) -> dict[str, Any]:
        """A picture that takes so many seconds, within NEAR, at the last of three attempts."""
        for _ in range(3):
            fixed, each = self.costs[name]
            spp = max(16, round((seconds - fixed) / each))
            picture, spent = self._picture(METHODS[name], spp, seed)
            self.costs[name] = cost(spent, spp)
            if abs(sum(spent.values()) - seconds) < NEAR * seconds:
                break
        return {"error": self.error(picture), "seconds": sum(spent.values()), "spp": spp, "spent": spent}

    def _first(self, joins: bool | None) -> tuple[float, float]:
        for spp in (64, WARM):
            self._picture(joins, spp, 0)  # compiles
        return cost(self._picture(joins, WARM, 0)[1], WARM)

    def _picture(self, joins: bool | None, spp: int, seed: int) -> tuple[Tensor, dict[str, float]]:
        if joins is not None:
            made = equal_time.guided_picture(self.mi, self.scene, spp, DEPTH, seed, joins=joins)
            return made.picture, made.spent
        begin = time.process_time()
        picture = equal_time.rendered(self.mi, self.scene, self.path, spp, seed)
        return picture, {"regular samples": time.process_time() - begin}


def cost(spent: dict[str, float], spp: int) -> tuple[float, float]:
    """Seconds that do not depend on the samples, and seconds of a sample a pixel."""
    fixed = sum(seconds for name, seconds in spent.items() if not name.endswith(("samples", "learned from")))
    return fixed, (sum(spent.values()) - fixed) / spp


def measure(options: argparse.Namespace, file: Path) -> list[dict[str, Any]]:
    """Measure all, and keep it, a line each, as soon as it is known."""
    found = []
    with file.open("w", encoding="utf-8") as out:
        for name in options.scenes:
            bench = Bench(scenes()[name], options.size, options.reference)
            for seconds, method, seed in itertools.product(options.times, METHODS, range(1, options.seeds + 1)):
                row = {"scene": name, "method": method, "time": seconds, "seed": seed, "reference": bench.own_error}
                found.append(row | bench.measured(method, seconds, seed))
                print(json.dumps(found[-1]), file=out, flush=True)
    return found


def table(rows: list[dict[str, Any]]) -> str:
    """Errors over those of `regular + NEE` in the same time and scene, with 95 % intervals, as markdown."""
    errors = {(row["scene"], row["method"], row["time"], row["seed"]): row["error"] for row in rows}
    lines = ["| scenes | seconds | method | MAPE over regular + NEE | MAPE |", "|---|---|---|---|---|"]
    times = sorted({row["time"] for row in rows})
    for kind, seconds, method in itertools.product(KINDS, times, METHODS):
        mine = {
            key: error for key, error in errors.items() if kind_of(key[0]) == kind and key[1:3] == (method, seconds)
        }
        logs = [math.log(error / errors[key[0], "regular + NEE", *key[2:]]) for key, error in mine.items()]
        if logs:
            half = 1.96 * statistics.stdev(logs) / math.sqrt(len(logs)) if len(logs) > 1 else math.nan
            middle = statistics.fmean(logs)
            low, high = math.exp(middle - half), math.exp(middle + half)
            mean = statistics.fmean(mine.values())
            lines.append(
                f"| {kind} | {seconds:g} | {method} | {math.exp(middle):.2f} [{low:.2f}, {high:.2f}] | {mean:.3f} |"
            )
    return "\n".join(lines)


def figure(rows: list[dict[str, Any]], file: Path) -> None:
    """Error over seconds, both logarithmic, a panel for each kind of scene."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    drawn, panels = pyplot.subplots(1, len(KINDS), figsize=(10, 3.2), sharex=True)
    for kind, panel in zip(KINDS, panels, strict=True):
        for method in METHODS:
            mine = [row for row in rows if kind_of(row["scene"]) == kind and row["method"] == method]
            by_time = [[row for row in mine if row["time"] == seconds] for seconds in sorted({r["time"] for r in mine})]
            xs, ys = (
                [statistics.geometric_mean(row[key] for row in each) for each in by_time]
                for key in ("seconds", "error")
            )
            panel.loglog(xs, ys, marker="o", label=method)
        panel.set_title(kind)
        panel.set_xlabel("seconds of CPU, everything counted")
        panel.grid(visible=True, which="both", alpha=0.3)
    panels[0].set_ylabel("MAPE")
    panels[0].legend()
    drawn.tight_layout()
    drawn.savefig(file, dpi=120)


def main() -> None:
    """Measure, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="px along a side")
    parser.add_argument("--reference", type=int, default=8192, help="samples a pixel of the reference")
    parser.add_argument("--times", type=float, nargs="+", default=[1.0, 4.0, 16.0], help="seconds of CPU")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scenes", nargs="+", default=list(scenes()), choices=list(scenes()))
    parser.add_argument("--out", type=Path, default=Path("runs/guiding"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    rows = measure(options, options.out / "guiding.jsonl")
    print(table(rows))
    figure(rows, options.out / "guiding.png")


if __name__ == "__main__":
    main()

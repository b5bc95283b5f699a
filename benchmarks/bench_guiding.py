"""Error over seconds of guided and regular paths, in equal total time: `make guiding`.

Each picture is made anew for its time, with everything counted: for guided ones also what is learned, for both loading
of the integrator and the film. The code that Dr.Jit compiles once is not. Times are CPU seconds of the process, so that
other work on the machine counts little. Errors are of every fourth pixel of every fourth row, as references are dear;
these are kept in a folder, and rows of earlier runs in the same file stay.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import re
import statistics
import time
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import metapp.mitsuba  # noqa: F401  (registers guided_path)
from benchmarks.guiding_scenes import scene_kind, scenes_by_name
from data_tools.synthetic.cornell import SceneEntry
from metapp.appearance.metrics import mape
from metapp.extensions.guided import rendering
from metapp.extensions.guided.integrator import MIN_LEARNING_PATHS
from metapp.extensions.scene_files.scene_reader import read_scene
from metapp.rendering.paths.path_space import DEPTH_EDGES
from metapp.rendering.pictures import render_scene
from metapp.rendering.scenes.loading import load_scene

REGULAR_METHOD, GUIDED_INTEGRATOR = "regular + NEE", {"type": "metapp_guided_path"}
INTEGRATORS_BY_METHOD: dict[str, dict[str, Any]] = {  # integrators
    REGULAR_METHOD: {"type": "path"},
    "guided + NEE": GUIDED_INTEGRATOR,
}
WARM_UP_SPP = 48  # samples a pixel by which code is compiled and speeds are first known
TIME_TOLERANCE_SHARE = 0.1  # of the seconds
REFERENCE_STEP_PX = 4  # px between those that references are made of
PATHS_PER_WAVE = 2**21  # paths at a time


class SceneBench:
    """One scene.

    Args:
        name: of the scene.
        options: of the command line.
    """

    def __init__(self, name: str, options: argparse.Namespace) -> None:
        self.mi, self.scene, _ = load_scene(options.known[name])
        rendering.resize_film(self.scene, options.size)
        self.width, self.height = (int(n) for n in self.scene.sensors()[0].film().size())
        self.path = self.mi.load_dict({"type": "path", "max_depth": DEPTH_EDGES})
        file = options.out / f"{name.replace(' ', '-')}-{options.size}-{options.reference}.pt"
        if not file.exists():
            torch.save(torch.stack([self._half(options, seed) for seed in (1, 2)]), file)
        halves = torch.load(file, weights_only=True)
        self.reference = halves.mean(0)
        self.own_error = float(mape(halves[:1], self.reference[None]))  # both halves are as far from the mean
        self.costs = {name: self._first(name) for name in {REGULAR_METHOD, *options.methods}}

    def _half(self, options: argparse.Namespace, seed: int) -> Tensor:
        """A picture by `path`, with next-event estimation, of half the reference's samples a pixel."""
        import drjit as dr

        mi, columns, rows = self.mi, self.width // REFERENCE_STEP_PX, self.height // REFERENCE_STEP_PX
        per_pixel = PATHS_PER_WAVE // (columns * rows)
        paths, waves = columns * rows * per_pixel, -(-options.reference // (2 * per_pixel))
        total = torch.zeros(3, rows, columns)
        for wave in range(waves):
            sampler: Any = mi.load_dict({"type": "independent"})
            sampler.seed(seed * 2**16 + wave, paths)
            index = dr.arange(mi.UInt32, paths) // per_pixel
            corner = (
                mi.Point2f(mi.Float(index % columns), mi.Float(index // columns)) * REFERENCE_STEP_PX
                + REFERENCE_STEP_PX // 2
            )
            film = (corner + sampler.next_2d()) / mi.Point2f(self.width, self.height)
            ray, weight = self.scene.sensors()[0].sample_ray(0, 0, film, mi.Point2f(0.5))
            light = self.path.sample(self.scene, sampler, mi.RayDifferential3f(ray))[0] * weight
            total += torch.from_numpy(dr.block_sum(light, per_pixel).numpy()).reshape(3, rows, columns)
        mean: Tensor = total / (per_pixel * waves)
        return mean

    def error(self, picture: Tensor) -> float:
        """MAPE of the reference's pixels."""
        rows, columns = self.reference.shape[-2:]
        pixels = picture[REFERENCE_STEP_PX // 2 :: REFERENCE_STEP_PX, REFERENCE_STEP_PX // 2 :: REFERENCE_STEP_PX][
            :rows, :columns
        ]
        return float(mape(pixels.permute(2, 0, 1)[None], self.reference[None]))

    def measured(self, name: str, seconds: float, seed: int) -> dict[str, Any]:
        """A picture that takes so many seconds, within NEAR, the nearest of three attempts."""
        least = -(-MIN_LEARNING_PATHS // (self.width * self.height)) if name != REGULAR_METHOD else 1
        attempts: list[tuple[Tensor, dict[str, float], int]] = []

        def off(attempt: tuple[Tensor, dict[str, float], int]) -> float:
            return abs(sum(attempt[1].values()) / seconds - 1)

        for _ in range(3):
            fixed, per_sample = self.costs[name]
            spp = max(least, round((seconds - fixed) / per_sample))
            attempts.append((*self._picture(name, spp, seed), spp))
            self.costs[name] = fit_costs(*attempts[-1][1:])
            if off(attempts[-1]) < TIME_TOLERANCE_SHARE:
                break
        picture, spent, spp = min(attempts, key=off)
        if name != REGULAR_METHOD and spp == least and sum(spent.values()) > (1 + TIME_TOLERANCE_SHARE) * seconds:
            # it takes longer: fewer samples, which `path` renders
            spp = max(1, min(least - 1, round(seconds / self.costs[REGULAR_METHOD][1])))
            picture, spent = self._picture(name, spp, seed)
        return {"error": self.error(picture), "seconds": sum(spent.values()), "spp": spp, "spent": spent}

    def _first(self, name: str) -> tuple[float, float]:
        spp = (
            WARM_UP_SPP
            if name == REGULAR_METHOD
            else max(WARM_UP_SPP, -(-MIN_LEARNING_PATHS // (self.width * self.height)))
        )
        for _ in range(2):
            self._picture(name, spp, 0)  # compiles
        return fit_costs(self._picture(name, spp, 0)[1], spp)

    def _picture(self, name: str, spp: int, seed: int) -> tuple[Tensor, dict[str, float]]:
        """A picture, and seconds of CPU by what they were spent on."""
        begin = time.process_time()
        integrator = self.mi.load_dict(INTEGRATORS_BY_METHOD[name] | {"max_depth": DEPTH_EDGES})
        picture = render_scene(self.scene, integrator, spp, seed)
        spent, total = dict(getattr(integrator, "spent", {})), time.process_time() - begin
        rest = "all else" if spent else "regular samples"  # where `path` rendered instead
        return picture, spent | {rest: total - sum(spent.values())}


def fit_costs(spent: dict[str, float], spp: int) -> tuple[float, float]:
    """Seconds that do not depend on the samples, and seconds of a sample a pixel."""
    fixed = sum(seconds for name, seconds in spent.items() if not name.endswith(("samples", "learned from")))
    return fixed, (sum(spent.values()) - fixed) / spp


def measure_scenes(options: argparse.Namespace, file: Path) -> list[dict[str, Any]]:
    """Measure all, and keep it, a line each, as soon as it is known."""
    kept = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    rows = [row for row in kept if row["size"] == options.size]
    with file.open("a", encoding="utf-8") as out:
        for name in options.scenes:
            bench = SceneBench(name, options)
            for seconds, seed, method in itertools.product(options.times, range(1, options.seeds + 1), options.methods):
                row = {"size": options.size, "scene": name, "method": method, "time": seconds, "seed": seed}
                row["reference"] = bench.own_error
                rows.append(row | bench.measured(method, seconds, seed))
                print(json.dumps(rows[-1]), file=out, flush=True)
    keys = ("scene", "method", "time", "seed")
    return list({tuple(row[key] for key in keys): row for row in rows}.values())  # the last of each


def use_box_filter(scene: SceneEntry) -> SceneEntry:
    """The scene of an XML file with a box filter: pixels are means, as those of references."""
    return {"xml": re.sub(r'<rfilter [^>]*type="\w+"', '<rfilter type="box"', scene["xml"])}


def list_kinds(rows: list[dict[str, Any]]) -> list[str]:
    """What scenes are counted among, in their order."""
    return list(dict.fromkeys(scene_kind(row["scene"]) for row in rows))


def format_error_table(rows: list[dict[str, Any]]) -> str:
    """Errors over those of `regular + NEE` in the same time and scene, with 95 % intervals, as markdown."""
    errors = {(row["scene"], row["method"], row["time"], row["seed"]): row["error"] for row in rows}
    lines = ["| scenes | seconds | method | MAPE over regular + NEE | MAPE |", "|---|---|---|---|---|"]
    times = sorted({row["time"] for row in rows})
    for kind, seconds, method in itertools.product(list_kinds(rows), times, INTEGRATORS_BY_METHOD):
        mine = {
            key: error for key, error in errors.items() if scene_kind(key[0]) == kind and key[1:3] == (method, seconds)
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


def draw_guiding_figure(rows: list[dict[str, Any]], file: Path) -> None:
    """Error over seconds, both logarithmic, a panel for each kind of scene."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list_kinds(rows)
    drawn, panels = pyplot.subplots(1, len(names), figsize=(3 * len(names), 3.2), sharex=True, squeeze=False)
    for kind, panel in zip(names, panels[0], strict=True):
        for method in INTEGRATORS_BY_METHOD:
            mine = [row for row in rows if scene_kind(row["scene"]) == kind and row["method"] == method]
            by_time = [[row for row in mine if row["time"] == seconds] for seconds in sorted({r["time"] for r in mine})]
            if not mine:
                continue
            xs, ys = (
                [statistics.geometric_mean(row[key] for row in same) for same in by_time]
                for key in ("seconds", "error")
            )
            panel.loglog(xs, ys, marker="o", label=method)
        panel.set_title(kind)
        panel.set_xlabel("seconds of CPU")
        panel.grid(visible=True, which="both", alpha=0.3)
    panels[0, 0].set_ylabel("MAPE")
    drawn.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="upper center", ncols=len(INTEGRATORS_BY_METHOD), frameon=False
    )
    drawn.tight_layout(rect=(0, 0, 1, 0.93))
    drawn.savefig(file, dpi=120)


def main() -> None:
    """Measure, print the table, draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="px along a side")
    parser.add_argument("--reference", type=int, default=8192, help="samples a pixel of the reference")
    parser.add_argument("--times", type=float, nargs="+", default=[1.0, 4.0, 16.0], help="seconds of CPU")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument(
        "--methods", nargs="+", default=list(INTEGRATORS_BY_METHOD), choices=list(INTEGRATORS_BY_METHOD)
    )
    parser.add_argument(
        "--scenes", nargs="+", default=list(scenes_by_name()), help="names, or scene files of Mitsuba 3"
    )
    parser.add_argument("--out", type=Path, default=Path("runs/guiding"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")
    files = {name: Path(name) for name in options.scenes if name not in scenes_by_name()}
    options.known = scenes_by_name() | {file.parent.name: use_box_filter(read_scene(file)) for file in files.values()}
    options.scenes = [files[name].parent.name if name in files else name for name in options.scenes]
    rows = measure_scenes(options, options.out / "guiding.jsonl")
    print(format_error_table(rows))
    draw_guiding_figure(rows, options.out / "guiding.png")


if __name__ == "__main__":
    main()

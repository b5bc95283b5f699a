"""Error over seconds of guided and regular paths, in equal total time: `make guiding`.

Each picture is made anew for its time, and everything counts: loading of the integrator, film, and for guided paths
also what they learn. Only the code that Dr.Jit compiles once does not count. Times are CPU seconds of the process, so
that other work on the machine counts little. Errors are of every fourth pixel of every fourth row, since references are
expensive. References are kept in a folder, and rows of earlier runs in the same file stay.
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
INTEGRATORS_BY_METHOD: dict[str, dict[str, Any]] = {
    REGULAR_METHOD: {"type": "path"},
    "guided + NEE": GUIDED_INTEGRATOR,
}
WARM_UP_SPP = 48  # samples a pixel of the first pictures, which compile code and tell the first speeds
TIME_TOLERANCE_SHARE = 0.1  # share of the wanted seconds by which a picture may take more or less
REFERENCE_STEP_PX = 4  # px from one pixel of a reference to the next
FILTERS = ("box", "catmullrom", "gaussian", "lanczos", "mitchell", "tent")  # Mitsuba's reconstruction filters
PATHS_PER_WAVE = 2**21  # paths that are traced at a time


class SceneBench:
    """One scene, with its reference and the costs of each method.

    Args:
        name: the name of the scene.
        options: the options of the command line.
    """

    def __init__(self, name: str, options: argparse.Namespace) -> None:
        self.mi, self.scene, _ = load_scene(options.known[name])
        rendering.resize_film(self.scene, options.size)
        self.width, self.height = (int(n) for n in self.scene.sensors()[0].film().size())
        self.path = self.mi.load_dict({"type": "path", "max_depth": DEPTH_EDGES})
        file = options.out / f"{name.replace(' ', '-')}-{options.size}-{options.reference}.pt"
        if not file.exists():
            torch.save(torch.stack([self._render_half(options, seed) for seed in (1, 2)]), file)
        halves = torch.load(file, weights_only=True)
        self.reference = halves.mean(0)
        self.own_error = float(mape(halves[:1], self.reference[None]))  # both halves are equally far from their mean
        self.costs = {name: self._first_costs(name) for name in {REGULAR_METHOD, *options.methods}}

    def _render_half(self, options: argparse.Namespace, seed: int) -> Tensor:
        """Render a picture by `path`, with next-event estimation, by half the reference's samples a pixel."""
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

    def picture_error(self, picture: Tensor) -> float:
        """Return the MAPE of a picture [H, W, 3] over the pixels that the reference has."""
        rows, columns = self.reference.shape[-2:]
        pixels = picture[REFERENCE_STEP_PX // 2 :: REFERENCE_STEP_PX, REFERENCE_STEP_PX // 2 :: REFERENCE_STEP_PX][
            :rows, :columns
        ]
        return float(mape(pixels.permute(2, 0, 1)[None], self.reference[None]))

    def measure_at_seconds(self, name: str, seconds: float, seed: int) -> dict[str, Any]:
        """Render a picture that takes about this many seconds, the best of three attempts, and return its figures."""
        min_spp = -(-MIN_LEARNING_PATHS // (self.width * self.height)) if name != REGULAR_METHOD else 1
        attempts: list[tuple[Tensor, dict[str, float], int]] = []

        def time_deviation(attempt: tuple[Tensor, dict[str, float], int]) -> float:
            return abs(sum(attempt[1].values()) / seconds - 1)

        for _ in range(3):
            fixed, per_sample = self.costs[name]
            spp = max(min_spp, round((seconds - fixed) / per_sample))
            attempts.append((*self._render(name, spp, seed), spp))
            self.costs[name] = fit_costs(*attempts[-1][1:])
            if time_deviation(attempts[-1]) < TIME_TOLERANCE_SHARE:
                break
        picture, spent, spp = min(attempts, key=time_deviation)
        if name != REGULAR_METHOD and spp == min_spp and sum(spent.values()) > (1 + TIME_TOLERANCE_SHARE) * seconds:
            # the fewest paths that guiding learns from take too long: with fewer samples, `path` renders instead
            spp = max(1, min(min_spp - 1, round(seconds / self.costs[REGULAR_METHOD][1])))
            picture, spent = self._render(name, spp, seed)
        return {"error": self.picture_error(picture), "seconds": sum(spent.values()), "spp": spp, "spent": spent}

    def _first_costs(self, name: str) -> tuple[float, float]:
        """Render three small pictures, and return the costs of the last, when all code is compiled."""
        spp = (
            WARM_UP_SPP
            if name == REGULAR_METHOD
            else max(WARM_UP_SPP, -(-MIN_LEARNING_PATHS // (self.width * self.height)))
        )
        for _ in range(2):
            self._render(name, spp, 0)  # compiles code, which is not timed
        return fit_costs(self._render(name, spp, 0)[1], spp)

    def _render(self, name: str, spp: int, seed: int) -> tuple[Tensor, dict[str, float]]:
        """Render a picture, and return it with its CPU seconds by what they were spent on."""
        begin = time.process_time()
        integrator = self.mi.load_dict(INTEGRATORS_BY_METHOD[name] | {"max_depth": DEPTH_EDGES})
        picture = render_scene(self.scene, integrator, spp, seed)
        spent, total = dict(getattr(integrator, "spent", {})), time.process_time() - begin
        rest = "all else" if spent else "regular samples"  # `path` says nothing of its seconds
        return picture, spent | {rest: total - sum(spent.values())}


def fit_costs(spent: dict[str, float], spp: int) -> tuple[float, float]:
    """Return the seconds that do not depend on the samples, and the seconds of one sample a pixel."""
    fixed = sum(seconds for name, seconds in spent.items() if not name.endswith(("samples", "learned from")))
    return fixed, (sum(spent.values()) - fixed) / spp


def measure_scenes(options: argparse.Namespace, file: Path) -> list[dict[str, Any]]:
    """Measure all scenes, times, seeds and methods; each row is written to the file as soon as it is known."""
    earlier_rows = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    rows = [row for row in earlier_rows if row["size"] == options.size]
    with file.open("a", encoding="utf-8") as out:
        for name in options.scenes:
            bench = SceneBench(name, options)
            for seconds, seed, method in itertools.product(options.times, range(1, options.seeds + 1), options.methods):
                row = {"size": options.size, "scene": name, "method": method, "time": seconds, "seed": seed}
                row["reference"] = bench.own_error
                rows.append(row | bench.measure_at_seconds(method, seconds, seed))
                print(json.dumps(rows[-1]), file=out, flush=True)
    keys = ("scene", "method", "time", "seed")
    return list({tuple(row[key] for key in keys): row for row in rows}.values())  # the last row of each


def use_box_filter(scene: SceneEntry) -> SceneEntry:
    """Return a scene with box filters in place of its filters: pixels are means then, as in references."""
    if scene["type"] in FILTERS:
        return {"type": "box"}
    return {name: use_box_filter(value) if isinstance(value, dict) else value for name, value in scene.items()}


def list_kinds(rows: list[dict[str, Any]]) -> list[str]:
    """Return the kinds of scenes in rows, in their order."""
    return list(dict.fromkeys(scene_kind(row["scene"]) for row in rows))


def format_error_table(rows: list[dict[str, Any]]) -> str:
    """Format errors, relative to regular paths in equal time, with 95 % intervals, as Markdown."""
    errors = {(row["scene"], row["method"], row["time"], row["seed"]): row["error"] for row in rows}
    lines = ["| scenes | seconds | method | MAPE over regular + NEE | MAPE |", "|---|---|---|---|---|"]
    times = sorted({row["time"] for row in rows})
    for kind, seconds, method in itertools.product(list_kinds(rows), times, INTEGRATORS_BY_METHOD):
        method_errors = {
            key: error for key, error in errors.items() if scene_kind(key[0]) == kind and key[1:3] == (method, seconds)
        }
        logs = [math.log(error / errors[key[0], "regular + NEE", *key[2:]]) for key, error in method_errors.items()]
        if logs:
            half_interval = 1.96 * statistics.stdev(logs) / math.sqrt(len(logs)) if len(logs) > 1 else math.nan
            middle = statistics.fmean(logs)
            low, high = math.exp(middle - half_interval), math.exp(middle + half_interval)
            mean = statistics.fmean(method_errors.values())
            lines.append(
                f"| {kind} | {seconds:g} | {method} | {math.exp(middle):.2f} [{low:.2f}, {high:.2f}] | {mean:.3f} |"
            )
    return "\n".join(lines)


def draw_guiding_figure(rows: list[dict[str, Any]], file: Path) -> None:
    """Draw error over seconds, both logarithmic, with a panel for each kind of scene."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list_kinds(rows)
    figure, panels = pyplot.subplots(1, len(names), figsize=(3 * len(names), 3.2), sharex=True, squeeze=False)
    for kind, panel in zip(names, panels[0], strict=True):
        for method in INTEGRATORS_BY_METHOD:
            method_rows = [row for row in rows if scene_kind(row["scene"]) == kind and row["method"] == method]
            by_time = [
                [row for row in method_rows if row["time"] == seconds]
                for seconds in sorted({row["time"] for row in method_rows})
            ]
            if not method_rows:
                continue
            xs, ys = (
                [statistics.geometric_mean(row[key] for row in time_rows) for time_rows in by_time]
                for key in ("seconds", "error")
            )
            panel.loglog(xs, ys, marker="o", label=method)
        panel.set_title(kind)
        panel.set_xlabel("seconds of CPU")
        panel.grid(visible=True, which="both", alpha=0.3)
    panels[0, 0].set_ylabel("MAPE")
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="upper center", ncols=len(INTEGRATORS_BY_METHOD), frameon=False
    )
    figure.tight_layout(rect=(0, 0, 1, 0.93))
    figure.savefig(file, dpi=120)


def main() -> None:
    """Measure all scenes, print the table, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=256, help="pixels along a side of pictures")
    parser.add_argument("--reference", type=int, default=8192, help="samples a pixel of references")
    parser.add_argument(
        "--times", type=float, nargs="+", default=[1.0, 4.0, 16.0], help="seconds of CPU that pictures take"
    )
    parser.add_argument("--seeds", type=int, default=3, help="pictures of each scene, method and time")
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
    files_by_word = {name: Path(name) for name in options.scenes if name not in scenes_by_name()}
    options.known = scenes_by_name() | {
        file.parent.name: use_box_filter(read_scene(file)) for file in files_by_word.values()
    }
    options.scenes = [files_by_word[name].parent.name if name in files_by_word else name for name in options.scenes]
    rows = measure_scenes(options, options.out / "guiding.jsonl")
    print(format_error_table(rows))
    draw_guiding_figure(rows, options.out / "guiding.png")


if __name__ == "__main__":
    main()

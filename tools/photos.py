"""Errors of non-stationary svBRDFs against the number of photos: drawn TASKS [PARADIGM...] | real FOLDER [PICTURES].

drawn: so many test materials as `metapp data synth svbrdf_nonstationary --size 256 --photos 9` draws them, fitted to
their first 1, 2, 5 and 9 photos by all paradigms, with checkpoints that ship: one photo by recipe full, others by
several. The baseline takes the first photo for a flat diffuse colour.

real: a folder of photos with places: fits of any k photos that follow each other (the first after the last), judged by
the others, which no fit saw, rendered from the places that the folder gives, as bright as the photo is on average: RMSE
at gamma 2.2 and 1 - SSIM, means over photos, then over fits. PICTURES: a folder for these of the first fit by each k.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.placed_photos import read_task
from data_tools.synthetic.svbrdf_nonstationary import synthetic_tasks
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import expose
from metapp.appearance.metrics import ssim
from metapp.appearance.presentation import Picture
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import CLIPPED, FLASH, flashes_of, linear, photographed
from metapp.apps.svbrdf_nonstationary.presentation import fine_maps
from metapp.baselines import baselines_of
from metapp.baselines.baseline import Training
from metapp.evaluation.baseline_fits import allowed_for
from metapp.learning.app import stack
from metapp.learning.task import Params, Task
from metapp.runs.checkpoints import find_checkpoint
from metapp.runs.fits import fit_tasks, rng_of
from metapp.runs.outputs import write_pictures
from metapp.runs.plan import Plan, plan
from metapp.runs.request import Request
from metapp.runs.statistics import paired

NAME, COUNTS, SIDE = "svbrdf_nonstationary", (1, 2, 5, 9), 256
PARADIGMS = ("general", "overfit", "finetune", "quickft", "meta")
FITTED = ("general", "quickft", "meta")  # of real photos


def cut(task: Task, photos: list[int]) -> Task:
    """A task with these photos alone, the first of which General reads; one has no place, as it is fitted today."""
    every = torch.cat([task.data["photo"][None], task.data["others"]])[photos]
    data = {"photo": every[0]} | ({"maps": task.data["maps"]} if "maps" in task.data else {})
    if len(photos) > 1:
        data |= {"others": every[1:], "places": task.data["places"][photos]}
    return task._replace(data=data)


def planned(paradigm: str, photos: int) -> Plan:
    """What fits so many photos."""
    recipe = "several" if photos > 1 else "full"
    return find_checkpoint(plan(Request(NAME, paradigm, observe="photo", recipe=recipe, device="cpu", quiet=True)))


@torch.no_grad()
def flat_errors(tasks: list[Task]) -> dict[str, float]:
    """Of the first photo as a flat diffuse colour, the baseline that needs no other material."""
    by = planned("general", 1)
    baseline = next(each for each in baselines_of(by.app) if each.name == "flat")
    prepared, errors = baseline.prepare(Training(by.app, ()), allowed_for(by)), {}
    for task in tasks:
        stacked = stack(by.app, [cut(task, [0])])
        answer = prepared.fit(stacked, rng_of(by, task), allowed_for(by)).answer()
        errors[task.name] = float(by.app.errors_of(answer, stacked)["error"])
    return errors


def drawn(total: int, paradigms: tuple[str, ...]) -> None:
    """Print errors of test tasks by paradigm and number of photos, over those of one and of QuickFT."""
    tasks = list(synthetic_tasks("test", total, size=SIDE, photos=max(COUNTS)))
    groups = {task.name: task.name for task in tasks}
    flat = flat_errors(tasks)
    print(f"| {len(tasks)} materials | " + " | ".join(f"{count} photos" for count in COUNTS) + " |")
    print(f"| flat | {sum(flat.values()) / len(flat):.3f} |", flush=True)
    quickft: dict[int, dict[str, float]] = {}
    for name in ("quickft", *(name for name in paradigms if name != "quickft")):
        cells: list[str] = []
        one: dict[str, float] = {}
        for count in COUNTS:
            by = planned(name, count)
            chosen = [cut(task, list(range(count))) for task in tasks]
            records = [record for record, _ in fit_tasks(by, chosen)]
            errors = {record["name"]: record["error"] for record in records}
            seconds = sorted(record["seconds"] for record in records)[len(records) // 2]
            one, beside = one or errors, quickft.setdefault(count, errors)
            words = [f"{sum(errors.values()) / len(errors):.3f} ({seconds:.1f} s)"]
            words += [f"over one {paired([errors], [one], groups, logarithmic=False)}"] if count > 1 else []
            words += (
                [f"over quickft {paired([errors], [beside], groups, logarithmic=False)}"] if name != "quickft" else []
            )
            cells.append(", ".join(words))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


@torch.no_grad()
def rendered(app: SvbrdfNonstationary, theta: Params, fitted: Task, place: Tensor, photo: Tensor) -> Tensor:
    """A photo that the fit did not see, linear [3, S, S], from its place [2, 3], at its mean where it does not clip."""
    maps = fine_maps(
        app.field._replace(height=photo.shape[-2], width=photo.shape[-1]),
        {key: value[None] for key, value in theta.items()},
        linear(fitted.data["photo"])[None],
    )
    shown = photographed(maps, flashes_of(torch.zeros(1, FLASH, 1), place[None, None]))[0, 0]
    whole = photo < CLIPPED
    return shown * (photo[whole].sum() / shown[whole].sum())


def real(folder: Path, pictures: Path | None) -> None:
    """Print how far held-out photos are off, by paradigm and number of photos."""
    task = read_task(folder, 2048)
    every = torch.cat([task.data["photo"][None], task.data["others"]])
    total = len(every)
    print("| paradigm | " + " | ".join(f"{count} photos: RMSE, 1 - SSIM" for count in range(1, total)) + " |")
    for name in FITTED:
        cells = []
        for count in range(1, total):
            by, off = planned(name, count), []
            assert isinstance(by.app, SvbrdfNonstationary)
            for first in range(total):
                seen = [(first + i) % total for i in range(count)]
                chosen = cut(task, seen)
                (_, theta), *_ = fit_tasks(by, [chosen])
                for held in sorted(set(range(total)) - set(seen)):
                    photo = linear(every[held])
                    made = rendered(by.app, theta, chosen, task.data["places"][held], photo)
                    pair = [expose(each)[None] for each in (made, photo)]
                    rmse = float((pair[0] - pair[1]).square().mean().sqrt())
                    off.append((rmse, 1 - float(ssim(*pair).mean())))
                    if pictures and not first:
                        beside = torch.cat([photo, made], -1).permute(1, 2, 0)
                        write_pictures(
                            {f"{name}-{count}-photo{held}": Picture(linear_to_srgb(beside), "srgb")}, pictures
                        )
            cells.append(" ".join(f"{sum(each) / len(off):.4f}" for each in zip(*off, strict=True)))
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    what, place, *more = sys.argv[1:]
    if what == "drawn":
        drawn(int(place), tuple(more) or PARADIGMS)
    else:
        real(Path(place), Path(more[0]) if more else None)

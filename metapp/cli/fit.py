"""`metapp general|overfit|finetune|quickft|meta`: fit tasks by one paradigm."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metapp.cli.console import number, out, print_json, progress, say

if TYPE_CHECKING:
    from torch import Generator

    from metapp.experiments.session import Options, Start
    from metapp.learning.app import App
    from metapp.learning.task import Params, Task, Tasks
    from metapp.paradigms import Job, Paradigm
    from metapp.storage.records import RunFolder

RULE_NAMES = "meta-sgd, meta-adam, meta-adam-tied, meta-curvature, meta-encoder, meta-lgd, meta-mean, meta-basis"
PART_NAMES = "adam, tied, sgd, rates, shared, betas, loss, pace, eps, curvature, network, average, basis"
APP_HELP = "Application: brdf, texture, svbrdf_stationary, svbrdf_nonstationary, illumination, transport."


def make_command(name: str, summary: str) -> Any:
    """The command of one paradigm; they differ in name and help only."""

    def command(
        app: Annotated[str, typer.Argument(metavar="APP", help=APP_HELP)],
        inputs: Annotated[
            list[Path] | None,
            typer.Argument(
                metavar="[INPUT]...",
                help="What to fit: brdf: MERL .binary files, NBRDF folders; texture: images; svbrdf_stationary: flash "
                "photos; svbrdf_nonstationary: strips, a material's maps, flash photos; illumination: HDR maps (.exr, "
                ".hdr) or photos of a sphere; transport: Mitsuba scenes. Without any, the test tasks of --data.",
            ),
        ] = None,
        steps: Annotated[int | None, typer.Option(help="Gradient steps instead of the recipe's.", min=0)] = None,
        rule: Annotated[
            str,
            typer.Option(
                help=f"Meta's rule: {RULE_NAMES}; or parts of rules with + between them, such as "
                f"adam+curvature+average, of {PART_NAMES}; default: the recipe's best."
            ),
        ] = "",
        observe: Annotated[
            str,
            typer.Option(help="What a fit may see, where an application has both: reference (the default) or photo."),
        ] = "",
        train: Annotated[bool, typer.Option("--train", help="Train the start on the training tasks first.")] = False,
        train_steps: Annotated[
            int | None, typer.Option(help="Outer training steps instead of the recipe's.", min=1)
        ] = None,
        data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None,
        out_folder: Annotated[Path, typer.Option("--out", help="Where runs and trained starts are kept.")] = Path(
            "runs"
        ),
        checkpoint: Annotated[
            Path | None, typer.Option(help="Start to use; default: trained here, else shipped.")
        ] = None,
        recipe: Annotated[str, typer.Option(help="quick or paper; texture: also paper-vgg19.")] = "quick",
        scene_root: Annotated[
            list[Path] | None,
            typer.Option(
                metavar="DIR",
                exists=True,
                file_okay=False,
                help="A folder beside a scene's own that its meshes, bitmaps, spectra and includes may come from; for "
                "transport. Plugins never do.",
            ),
        ] = None,
        export: Annotated[str, typer.Option(help="Write each fit in another form; brdf: nbrdf or merl.")] = "",
        seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0,
        device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
        json: Annotated[bool, typer.Option("--json", help="One JSON object as last line of standard output.")] = False,
        quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no table.")] = False,
    ) -> None:
        from metapp.experiments.session import Options, check_protocol, check_recipe, check_rule, find_app, find_device

        found = find_app(app)
        check_protocol(observe, found)
        if export and export not in found.exports:
            expected = f"expects one of {', '.join(found.exports)}" if found.exports else "has none; leave it out"
            raise typer.BadParameter(f"--export '{export}': {found.name} {expected}.")
        if train_steps and not train:
            raise typer.BadParameter("--train-steps: only with --train.")
        if scene_root and "mitsuba_scenes" not in found.readers:
            raise typer.BadParameter(f"--scene-root: {found.name} has no scenes, only transport; leave it out.")
        if rule and name != "meta":
            raise typer.BadParameter(f"--rule: only meta has learned rules, not {name}.")
        if steps and name == "general":
            raise typer.BadParameter("--steps: general takes none; finetune and quickft go on from it.")
        if checkpoint and name == "overfit":
            raise typer.BadParameter("--checkpoint: overfit starts at random; leave it out.")
        check_recipe(recipe, found)
        placed = found.at(found.recipes[recipe], observe)
        options = Options(
            app=placed,
            recipe=recipe,
            rule=check_rule(rule, placed, recipe),
            steps=steps,
            data=data,
            out=out_folder,
            checkpoint=checkpoint,
            seed=seed,
            device=find_device(device, found),
            quiet=quiet,
        )
        document = fit(
            options,
            name,
            inputs or [],
            train=train,
            train_steps=train_steps,
            export=export,
            scene_roots=scene_root or [],
            show=not json,
        )
        if json:
            print_json(document)

    command.__doc__ = summary
    return command


def fit(
    options: Options,
    paradigm_name: str,
    inputs: list[Path],
    *,
    train: bool = False,
    train_steps: int | None = None,
    export: str = "",
    scene_roots: Sequence[Path] = (),
    show: bool = True,
) -> dict[str, Any]:
    """Fit tasks, write the run folder, print the table.

    Returns:
        The document that --json prints.
    """
    from metapp.experiments.inputs import tasks_to_fit
    from metapp.experiments.pictures import picture_of_run, write_files
    from metapp.experiments.session import make_folder, name_of, observe_of, settings_of
    from metapp.experiments.starts import find_start, train_start
    from metapp.paradigms import paradigms
    from metapp.storage.records import FIT, RunFolder

    paradigm = paradigms()[paradigm_name]
    if options.steps == paradigm.steps(options.job.recipe):
        options = options._replace(steps=None)  # the recipe's own number is the recipe's own run
    make_folder(options.out)
    tasks, label = tasks_to_fit(options.app, inputs, options.data, options.quiet, scene_roots)
    if train:
        train_start(options, paradigm, train_steps)
    start = find_start(options, paradigm)
    settings = settings_of(options, paradigm, start, label)
    folder = RunFolder(run_path(options, settings, label), settings, FIT)
    if not options.quiet:
        what = f"{name_of(options.app)} {paradigm.name}"
        say(f"{what}: {len(tasks)} tasks, {settings['steps']} steps, start: {start.source}")
    # a finished run is run anew, one that was cut off is completed
    again = len(folder.finished()) >= len(tasks)
    records = run_tasks(options, paradigm, start, tasks, folder, again=again)
    made = write_files(options.app, tasks, folder.path)
    if export:
        export_all(options, tasks, folder, export)
    document = {
        "app": options.app.name,
        **observe_of(options.app),
        "paradigm": paradigm.name,
        "rule": settings["rule"],
        "steps": settings["steps"],
        "device": str(options.device),
        "data": label,
        **options.app.conditions(),
        **summary(records),
        "tasks": [{key: record[key] for key in ("name", "error", "seconds")} for record in records],
        "out": str(folder.path),
    }
    if not options.quiet:
        picture = picture_of_run(options.app, paradigm.name, tasks, records, folder.path)
        if show:
            out.print(table_of(options.app, paradigm.name, records))
        say(f"picture: {picture}\nrecords: {folder.file}" + (f"\nmade: {made}" if made else ""))
    return document


def run_path(options: Options, settings: dict[str, Any], label: str) -> Path:
    """runs/<app>/<paradigm>/<data>-<recipe>-seed<seed>, with rule, steps that are not the recipe's, and protocol."""
    name = f"{label}-{options.recipe}-seed{options.seed}"
    if settings["paradigm"] == "meta":
        name += f"-{settings['rule']}"
    if options.steps is not None:
        name += f"-{options.steps}steps"
    if options.app.protocol:
        name += f"-{options.app.protocol}"
    return options.out / options.app.name / settings["paradigm"] / name


def run_tasks(
    options: Options, paradigm: Paradigm, start: Start, tasks: list[Task], folder: RunFolder, *, again: bool = False
) -> list[dict[str, Any]]:
    """Fit each task that has no record yet, or all again, with a progress bar; the records of all, in order."""
    done = {} if again else folder.finished()
    with progress(options.quiet) as bar:
        row = bar.add_task(paradigm.name, total=len(tasks), completed=len(done), note="")
        missing = [task for task in tasks if task.name not in done]
        for record in fit_tasks(options, paradigm, start, missing, folder):
            done[record["name"]] = record
            bar.update(row, advance=1, note=f"{record['name']} {number(record['error'], '.3f')}".removesuffix(" -"))
    return [done[task.name] for task in tasks]


def fit_tasks(
    options: Options, paradigm: Paradigm, start: Start, tasks: list[Task], folder: RunFolder
) -> Iterator[dict[str, Any]]:
    """Fit tasks, each alone, so that its time is its own, and keep each as soon as it is done.

    The time is from the task's samples to the final parameters, warm. The error is None where a task holds no
    reference.

    Yields:
        Their records.
    """
    import torch

    from metapp.learning.app import stack

    app, job, device = options.app, options.job, options.device

    def fit_one(task: Any, steps: int | None) -> tuple[dict, float, Any]:
        rng = rng_of(options, task)
        _synchronise(torch, device)
        begin = time.perf_counter()
        stacked = stack(app, [task], device)
        theta = paradigm.fit(job if steps is None else job._replace(steps=steps), start.prepared, stacked, rng)
        _synchronise(torch, device)
        return theta, time.perf_counter() - begin, stacked

    for task in tasks if app.protocols else ():
        app.prepare(task)  # that one does not hold what a fit may see should not be found after an hour
    for task in tasks[:1]:
        fit_one(task, min(paradigm.count(job), 3))  # warm: first calls load kernels
    threads = torch.get_num_threads()
    for task in tasks:
        theta, seconds, stacked = fit_one(task, None)
        errors = {key: float(value[0]) for key, value in app.errors(theta, stacked).items()}
        errors |= {key: app.scale * value for key, value in errors.items() if key == "error"}
        finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
        if not finite or (errors and not math.isfinite(errors["error"])):
            what = "error is" if finite else "parameters are"
            raise FloatingPointError(f"{task.name}: the fit's {what} not finite; use another start or fewer steps.")
        # sums depend on the number of threads, in their last digits: the record says it, but its key does not, since
        # that is no reason to fit anew
        record = {"name": task.name, "error": None, **errors, "seconds": seconds, "threads": threads}
        record |= warning_of(paradigm, job, start, stacked, theta, rng_of(options, task))
        folder.add(record, {key: value[0] for key, value in theta.items()})
        yield record


def warning_of(
    paradigm: Paradigm, job: Job, start: Start, stacked: Tasks, theta: Params, rng: Generator
) -> dict[str, str]:
    """What a record says of a fit that leaves what it sees worse than its start: a learned rule can fail on a task.

    Args:
        paradigm, job, start: what the fit was made by.
        stacked: the one task.
        theta: the fit, [1, ...].
        rng: as it was at the beginning of the fit, so that the start is the same.
    """
    import torch

    if paradigm.count(job) == 0:
        return {}
    first = paradigm.start(job, start.prepared, stacked, rng)
    with torch.no_grad():
        batch = job.app.sample(stacked, torch.Generator(rng.device).manual_seed(0), job.recipe.batch)
        before, after = (float(job.app.loss(each, batch, {})[0]) for each in (first, theta))
    if after <= before:
        return {}
    warning = f"the visible loss rose from {before:.4g} to {after:.4g}"
    say(f"warning: {stacked.names[0]}: {warning}; try another rule, more steps or another paradigm.")
    return {"warning": warning}


def rng_of(options: Options, task: Task) -> Generator:
    """The source of a fit's draws: it depends on the task's name alone, whatever is fitted beside it."""
    from torch import Generator

    seed = int.from_bytes(
        hashlib.sha256(f"{options.seed} {task.name}".encode(errors="surrogatepass")).digest()[:6], "big"
    )
    return Generator(options.device).manual_seed(seed)


def _synchronise(torch: Any, device: Any) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def summary(records: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Mean error, as the table prints it, of tasks that have one, and median inference time of a task."""
    import statistics

    errors = [record["error"] for record in records if record["error"] is not None]
    return {
        "error": statistics.fmean(errors) if errors else None,
        "seconds": statistics.median(record["seconds"] for record in records),
    }


def table_of(app: App, paradigm: str, records: list[dict[str, Any]]) -> Any:
    """One line a task, and their mean."""
    from rich.table import Table
    from rich.text import Text

    from metapp.experiments.session import title_of

    factor = f" x{app.scale:g}" if app.scale != 1 else ""
    table = Table(title=f"{title_of(app)}: {paradigm}", show_footer=True, caption=caption_of(app))
    total = summary(records)
    table.add_column("task", "mean error, median time")
    table.add_column(f"error{factor}", number(total["error"], ".3f"), justify="right")
    table.add_column("seconds", number(total["seconds"], ".4f"), justify="right")
    for record in records:
        table.add_row(Text(record["name"]), number(record["error"], ".3f"), f"{record['seconds']:.4f}")
    return table


def caption_of(app: App) -> str:
    """What a table says about its errors."""
    seen = {"fits see": app.protocol} if app.protocol else {}
    conditions = "".join(f"; {key}: {value}" for key, value in (seen | app.conditions()).items())
    return f"error: {app.measure}{f' x{app.scale:g}' if app.scale != 1 else ''}{conditions}"


def export_all(options: Options, tasks: list[Task], folder: RunFolder, kind: str) -> None:
    """Write every fit of a run in another form, under <run>/<kind>/."""
    import importlib

    from metapp.storage.records import file_name

    tool = importlib.import_module(f"data_tools.{kind}")
    for task in tasks:
        theta = folder.theta(task.name)
        tool.export(options.app, theta, folder.path / kind / file_name(task.name))
    say(f"{len(tasks)} fits written as {kind}: {folder.path / kind}")

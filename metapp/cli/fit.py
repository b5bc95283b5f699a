"""`metapp general|overfit|finetune|quickft|meta`: fit tasks by one paradigm."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from data_tools.formats import exports_of, inputs_of
from metapp.apps import app_names
from metapp.cli.console import importing, say
from metapp.cli.fitting import fit, fit_lines, fit_many
from metapp.cli.options import Json

RULE_NAMES = (
    "meta-sgd, meta-adam, meta-adam-tied, meta-curvature, meta-encoder, meta-lgd, meta-mean, meta-basis, meta-axes, "
    "ridge"
)
PART_NAMES = "adam, tied, sgd, rates, shared, solve, betas, loss, pace, eps, curvature, network, average, basis"
APP_HELP = f"Application: {', '.join(app_names())}."


# of the five commands alike
INPUTS = "; ".join(f"{app}: {', '.join(each.inputs for each in inputs_of(app))}" for app in app_names())


def exports() -> str:
    """The values of --export, those of applications that have the same ones once."""
    apps: dict[str, list[str]] = {}
    for app in app_names():
        if exports_of(app):
            apps.setdefault(", ".join(exports_of(app)), []).append(app)
    return "; ".join(f"{', '.join(names)}: {forms}" for forms, names in apps.items())


def make_command(name: str, summary: str) -> Any:
    """The command of one paradigm; they differ in name and help only."""

    def command(
        app: Annotated[str, typer.Argument(metavar="APP", help=APP_HELP)],
        inputs: Annotated[
            list[Path] | None,
            typer.Argument(
                metavar="[INPUT]...",
                help=f"What to fit: {INPUTS}; or folders of these. Without any, the test tasks of --data. - with "
                "--json: one a line of standard input, each answered by a line at once.",
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
        budget: Annotated[
            str,
            typer.Option(
                metavar="TIME",
                help="Take as many of the steps as fit in this time a task, such as 50ms, 2s or 1.5min, of inference.",
            ),
        ] = "",
        watch: Annotated[
            bool, typer.Option("--watch", help="Rewrite watch.png in the run's folder as steps go by.")
        ] = False,
        batch: Annotated[
            str,
            typer.Option(
                metavar="N|auto",
                help="Fit inputs side by side: N, or what proves quick and fits in the memory. What has been fitted is "
                "not fitted again, what fails is listed at the end and stops nothing else; writes gallery.html.",
            ),
        ] = "",
        shard: Annotated[
            str, typer.Option(metavar="I/N", help="Fit every N-th input from the I-th on, of the same run folder.")
        ] = "",
        observe: Annotated[
            str,
            typer.Option(help="What a fit may see, where an application has both: reference (the default) or photo."),
        ] = "",
        train: Annotated[
            bool, typer.Option("--train", help="Train the checkpoint on the training tasks first.")
        ] = False,
        train_steps: Annotated[
            int | None, typer.Option(help="Outer training steps instead of the recipe's.", min=1)
        ] = None,
        data: Annotated[Path | None, typer.Option(help="Folder of task shards; default: the embedded set.")] = None,
        out_folder: Annotated[Path, typer.Option("--out", help="Where runs and trained checkpoints are kept.")] = Path(
            "runs"
        ),
        checkpoint: Annotated[
            Path | None, typer.Option(help="Checkpoint to use; default: trained here, else shipped.")
        ] = None,
        recipe: Annotated[
            str,
            typer.Option(
                help="quick, full or paper; brdf: also measured, for noisy or incomplete samples; texture: also "
                "paper-vgg19; default: full for files where no data, rule or checkpoint is given and fits by it are "
                "others (all but transport's), else quick."
            ),
        ] = "",
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
        fov: Annotated[
            float,
            typer.Option(
                metavar="DEGREES",
                min=0,
                max=150,
                help="The camera's field of view along the shorter side, for flash photos; 0: as EXIF says, else 45.",
            ),
        ] = 0,
        size: Annotated[
            str,
            typer.Option(
                metavar="HxW",
                help="px of what fits make: textures and maps of stationary svBRDFs to 4096x4096, illumination to "
                "1024x2048; default: four times the exemplar's, the map's as it is fitted.",
            ),
        ] = "",
        render: Annotated[
            int,
            typer.Option(
                metavar="PX",
                min=0,
                max=4096,
                help="Render each scene as well, guided at all bounces, and without a guide in the same time; for "
                "transport.",
            ),
        ] = 0,
        export: Annotated[str, typer.Option(help=f"Write each fit in another form; {exports()}.")] = "",
        seed: Annotated[int, typer.Option(help="Seed of all random draws.", min=0, max=2**63 - 1)] = 0,
        device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
        json: Json = False,
        quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar, no table.")] = False,
    ) -> None:
        with importing():
            from metapp.apps import presentation_of
            from metapp.runs.export import check_export
            from metapp.runs.inputs import Reading
            from metapp.runs.run import follow
            from metapp.runs.session import options_of

        options = options_of(
            app,
            observe=observe,
            rule=rule,
            recipe=recipe,
            own_files_by=name if inputs and not train else "",
            steps=steps,
            data=data,
            out=out_folder,
            checkpoint=checkpoint,
            seed=seed,
            device=device,
            quiet=quiet,
            budget=budget,
            watch=watch,
        )
        check_export(export, app)
        if train_steps and not train:
            raise typer.BadParameter("--train-steps: only with --train.")
        if scene_root and not any("roots" in form.takes for form in inputs_of(app)):
            raise typer.BadParameter(f"--scene-root: {app} has no scenes, only transport; leave it out.")
        if render and not presentation_of(options.app).renders:
            raise typer.BadParameter(f"--render: {app} has no scenes, only transport; leave it out.")
        if fov and not any("fov_rad" in form.takes for form in inputs_of(app)):
            raise typer.BadParameter(f"--fov: {app} has no flash photos; leave it out.")
        for said, unused in (
            ("--rule: only meta has learned rules", rule and name != "meta"),
            ("--steps: general takes none", steps and name == "general"),
            ("--checkpoint: overfit starts at random", checkpoint and name == "overfit"),
        ):
            if unused:  # scripts over all paradigms give all the same options
                say(f"{said}; the option is ignored.")
        if os.environ.get("RANK", "0") != "0":  # of torchrun: rank 0 alone fits
            return follow(options, name, train_steps) if train else None
        told: dict[str, Any] = {
            "train": train,
            "train_steps": train_steps,
            "export": export,
            "size": size,
            "reading": Reading(scene_root or [], math.radians(fov)),
        }
        lines = inputs == [Path("-")]
        if lines and (not json or batch or shard or render):
            raise typer.BadParameter("-: give --json, by which lines are answered, no --batch, --shard, --render.")
        if (batch or shard) and render:
            raise typer.BadParameter("--render: of scenes one by one; leave --batch and --shard out.")
        if lines:
            fit_lines(options, name, told)
        elif batch or shard:
            fit_many(options, name, inputs or [], batch, shard, told, json=json)
        else:
            fit(options, name, inputs or [], told, render=render, json=json)

    command.__doc__ = summary
    return command

"""`metapp data synth`: draw an embedded data set."""

from __future__ import annotations

import shutil
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from metapp import door
from metapp.cli import completion
from metapp.cli.data.convert import Quiet, check_folder, report
from metapp.cli.options import Json, annotated, plain, takes
from metapp.runs.inputs.convert import Converted, converted
from metapp.runs.inputs.embedded import embedded_apps, embedded_data, embedded_offer, split_counts
from metapp.runs.reporter import progress
from metapp.storage.text import meant

SHARDS = "shards"
_FORMS = [form for offer in door.offers(door.Synthetic) for form, _, _ in offer.files]
_OWN = {option.name: option for offer in door.offers(door.Synthetic) for option in offer.options}
_FOLDER = typer.Option(
    "--out",
    "-o",
    metavar="DIR",
    callback=check_folder,
    show_default="the user's cache",
    help="Folder to write to; made if missing. All commands look in the cache, which METAPP_CACHE moves.",
)
_FIELDS: list[tuple[str, object] | tuple[str, object, object]] = [
    (
        "name",
        Annotated[
            str,
            typer.Argument(
                metavar="APP", autocompletion=completion.applications, help=f"{', '.join(embedded_apps())}."
            ),
        ],
    ),
    ("folder", Annotated[Path | None, _FOLDER], field(default=None)),
    (
        "count",
        Annotated[
            int | None,
            typer.Option(
                min=1,
                metavar="N",
                show_default="the default set's",
                help="Tasks in total, of both splits in its proportion.",
            ),
        ],
        field(default=None),
    ),
    ("seed", Annotated[int, typer.Option(min=0, metavar="S", help="Of all random draws.")], field(default=0)),
    *((name, annotated(option, given=True), field(default=None)) for name, option in _OWN.items()),
    (
        "form",
        Annotated[
            str,
            typer.Option(
                "--as",
                metavar="FORM",
                help=f"shards, what metapp reads, or {', '.join(_FORMS)}: files in DIR/train and DIR/test.",
            ),
        ],
        field(default=SHARDS),
    ),
    ("quiet", Quiet, field(default=False)),
    ("as_json", Json, field(default=False)),
]
Synth = make_dataclass("Synth", _FIELDS)


def _synth(options: Any) -> None:
    name, known = options.name, embedded_apps()
    if name not in known:
        raise typer.BadParameter(
            f"'{name}' has no embedded data set, expected one of {', '.join(known)}.{meant(name, known)}",
            param_hint="APP",
        )
    own = {key: plain(value) for key in _OWN if (value := getattr(options, key)) is not None}
    if options.form != SHARDS:
        done = _write_files(options, own)
    else:
        from metapp.storage.manifest import read_manifest

        folder = embedded_data(name, options.seed, options.count, options.folder, options.quiet, own)
        done = converted(name, folder, read_manifest(folder).tasks)
    report(done, options.quiet, options.as_json)


def _write_files(options: Any, own: dict[str, Any]) -> Converted:
    """Write an embedded set in another form than shards."""
    from metapp.storage.shards import only_writer

    name, folder, form = options.name, options.folder, options.form
    forms = {word: (write, size) for word, write, size in embedded_offer(name).files}
    if form not in forms:
        expected = ", ".join([SHARDS, *forms])
        raise typer.BadParameter(f"'{form}': expected {expected} for {name}.", param_hint="--as")
    if own:
        flag = _OWN[next(iter(own))].flag
        raise typer.BadParameter(f"{form}: has no {flag}, expected shards with it.", param_hint="--as")
    if folder is None:
        raise typer.BadParameter(f"missing, expected a folder for the {form} files.", param_hint="--out")
    write, size = forms[form]
    counts = split_counts(name, options.count)
    needed = sum(counts.values()) * size
    free = shutil.disk_usage(next(part for part in (folder, *folder.absolute().parents) if part.exists())).free
    if free < needed:
        raise ValueError(
            f"{folder}: {free / 1e9:.1f} GB free, expected {needed / 1e9:.1f} GB for {sum(counts.values())} {form} "
            "files; take a smaller --count."
        )
    names: dict[str, list[str]] = {}
    folder.mkdir(parents=True, exist_ok=True)
    with only_writer(folder), progress(f"{form} files", sum(counts.values()), quiet=options.quiet) as bar:
        for split, number in counts.items():
            names[split] = []
            for task in door.load(write)(folder / split, split, number, options.seed):
                names[split].append(task)
                bar.advance(task)
    return Converted(name, str(folder), names["train"], names["test"], [])


_synth.__doc__ = "\n\n".join(
    [
        "Draw an embedded data set: synthetic tasks, the same on every machine.",
        *(f"{offer.app}: {offer.help}" for offer in door.offers(door.Synthetic)),
        "Examples:\n  metapp data synth brdf\n  metapp data synth brdf --count 10 --seed 1 --as merl --out materials",
    ]
)
synth = takes(Synth)(_synth)

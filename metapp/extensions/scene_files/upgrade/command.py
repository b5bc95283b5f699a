"""`metapp data upgrade`: a scene of Mitsuba 0.6 written for Mitsuba 3."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import Exit, out, print_json
from metapp.cli.data.convert import Quiet
from metapp.cli.options import Json, Overwrite, check_new, takes
from metapp.runs.reporter import say


@dataclass(frozen=True)
class Options:
    """The arguments and options of `upgrade`."""

    path: Annotated[Path, typer.Argument(metavar="FILE", help="A scene in XML.")]
    target: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="OUT.xml", show_default="FILE-v3.xml", help="File to write."),
    ] = None
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Write nothing: check FILE, and list what would be repaired.")
    ] = False
    roots: Annotated[
        list[Path] | None,
        typer.Option("--scene-root", metavar="DIR", help="A further folder that files of the scene may come from."),
    ] = None
    overwrite: Overwrite = False
    quiet: Quiet = False
    as_json: Json = False


@takes(Options)
def upgrade(options: Options) -> None:
    """Write a scene file anew for Mitsuba 3.

    A scene of Mitsuba 0.6, or for other people's integrators, is repaired: names, versions, integrators, samplers,
    films, colours, materials that version 3 lacks. Each repair is a line; FILE stays as it is. Exit code 1 if Mitsuba 3
    cannot load the scene.

    Examples:
      metapp data upgrade kitchen.xml --dry-run
      metapp data upgrade kitchen.xml --out kitchen-v3.xml
    """
    if options.target and options.dry_run:
        raise typer.BadParameter(
            "--dry-run writes nothing, expected one of the two; leave one out.", param_hint="--out"
        )
    from metapp.extensions.scene_files.upgrade.upgrade import lines, upgraded, verdict, write

    path, roots = options.path, options.roots or []
    target = None if options.dry_run else options.target or path.with_name(f"{path.stem}-v3.xml")
    check_new(target, options.overwrite)
    result = upgraded(path, roots)
    if target:
        write(result.root, target)
    for line in () if options.quiet else lines(result.repairs):
        out().print(f"{path}: {line}", soft_wrap=True)
    loaded = target or path
    answer = verdict(loaded, (path.resolve().parent, *roots))
    left = lines(result.left)
    problem = answer.problem and (left[0] if left else answer.problem)
    if not options.quiet:
        for line in left:
            say(f"warning: {path}: left as it is: {line}")
        if answer.limit:
            say(f"warning: {loaded}: Mitsuba 3 loads it, but metapp traces no such scene: {answer.limit}")
        if not problem:
            count = f"{len(result.repairs)} repair{'' if len(result.repairs) == 1 else 's'}"
            say(f"{loaded}: Mitsuba 3 loads it{f'; {count} of {path}' if target else ''}")
    if options.as_json:
        document = {"path": str(path), "out": str(target) if target else None, "loads": not problem}
        repairs = [repair._asdict() for repair in result.repairs]
        print_json({**document, "repairs": repairs, "left": left, "problem": problem, "limit": answer.limit})
    if problem:
        remedy = "" if target else f", or metapp data upgrade {path}"
        say(f"error: {loaded}: {problem.rstrip('.')}{remedy}")
        raise typer.Exit(Exit.FAILED)

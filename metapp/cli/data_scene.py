"""`metapp data scene`: the second scene of illumination, and scene files for Mitsuba 3."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.console import Exit, out, print_json
from metapp.cli.data_convert import Quiet
from metapp.cli.options import Json, takes
from metapp.runs.reporter import progress, say


@dataclass(frozen=True)
class SceneOptions:
    """The arguments and options of `scene`."""

    path: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="A scene in XML to check; none: build the second scene.")
    ] = None
    upgrade: Annotated[bool, typer.Option("--upgrade", help="Write the scene for Mitsuba 3, as a new file.")] = False
    target: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="OUT.xml", show_default="FILE-v3.xml", help="Of --upgrade: file to write."),
    ] = None
    roots: Annotated[
        list[Path] | None,
        typer.Option("--scene-root", metavar="DIR", help="A further folder that files of the scene may come from."),
    ] = None
    quiet: Quiet = False
    as_json: Json = False


@takes(SceneOptions)
def scene(options: SceneOptions) -> None:
    """Check a scene file, or write it anew for Mitsuba 3; without a FILE, build the second scene.

    A scene of Mitsuba 0.6, or for other people's integrators, is repaired by --upgrade: names, versions, integrators,
    samplers, films, colours, materials that version 3 lacks. Each repair is a line; FILE stays as it is. Without
    --upgrade these lines say what it would do. Exit code 1 if Mitsuba 3 cannot load the scene.

    The second scene, under which illumination is judged, is built once into the user's cache: Mitsuba finds how much
    of each direction's light reaches each pixel, in 20 s and 50 MB. The first fit that needs it builds it, too.

    Examples:
      metapp data scene
      metapp data scene kitchen.xml
      metapp data scene kitchen.xml --upgrade --out kitchen-v3.xml
    """
    if options.path is None:
        for name, given in {
            "--upgrade": options.upgrade,
            "--out": options.target,
            "--scene-root": options.roots,
        }.items():
            if given:
                raise typer.BadParameter("of a scene's FILE, expected one; name it.", param_hint=name)
        _second_scene(options.quiet, options.as_json)
    elif options.target and not options.upgrade:
        raise typer.BadParameter("of --upgrade, expected that too; add it.", param_hint="--out")
    else:
        _scene_file(options.path, options)


def _scene_file(path: Path, options: SceneOptions) -> None:
    from data_tools.readers.scene_upgrade import lines, upgraded, verdict, write

    roots = options.roots or []
    found = upgraded(path, roots)
    target = options.target or path.with_name(f"{path.stem}-v3.xml")
    if options.upgrade:
        write(found.root, target)
    for line in () if options.quiet else lines(found.repairs):
        out().print(f"{path}: {line}", markup=False, soft_wrap=True)
    judged = target if options.upgrade else path
    said = verdict(judged, (path.resolve().parent, *roots))
    left = lines(found.left)
    problem = said.problem and (left[0] if left else said.problem)
    if not options.quiet:
        for line in left:
            say(f"warning: {path}: left as it is: {line}")
        if said.limit:
            say(f"warning: {judged}: Mitsuba 3 loads it, but metapp traces no such scene: {said.limit}")
        if not problem:
            count = f"{len(found.repairs)} repair{'' if len(found.repairs) == 1 else 's'}"
            say(f"{judged}: Mitsuba 3 loads it{f'; {count} of {path}' if options.upgrade else ''}")
    if options.as_json:
        document = {"path": str(path), "out": str(target) if options.upgrade else None, "loads": not problem}
        repairs = [repair._asdict() for repair in found.repairs]
        print_json({**document, "repairs": repairs, "left": left, "problem": problem, "limit": said.limit})
    if problem:
        remedy = "" if options.upgrade else f", or metapp data scene {path} --upgrade"
        say(f"error: {judged}: {problem.rstrip('.')}{remedy}")
        raise typer.Exit(Exit.FAILED)


def _second_scene(quiet: bool, as_json: bool) -> None:
    from metapp.rendering.second_scene.relighting import matrix_path, transfer

    file = matrix_path()
    there = file.is_file()
    with progress("second scene", quiet=quiet) as bar:
        transfer(report=bar.at)
    size = file.stat().st_size
    if not quiet:
        say(f"second scene: {'there already' if there else 'done'}: {file}, {size / 1e6:.1f} MB")
    if as_json:
        print_json({"path": str(file), "bytes": size, "there_already": there})

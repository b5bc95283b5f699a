"""`metapp examples`: commands that work as they are, and the input files that they name."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, app_words, check_out_folder
from metapp.cli.console import print_json, standard_output
from metapp.names import did_you_mean
from metapp.registry import registry
from metapp.runs.reporter import say

VGG_APPS = ("svbrdf_stationary", "texture")  # applications whose fits do
EXAMPLE_INPUTS_FOLDER = Path("example-inputs")  # of the input files that commands name


def example_lines(app: str, folder: Path, most: int | None = None) -> list[tuple[str, str]]:
    """The first commands of an application on input files in a folder, and the result of each."""
    place = shlex.quote(str(folder))
    commands, examples = registry().commands, registry().examples[app].load()
    examples = [each for each in examples if {" ".join(each[0].split()[:n]) for n in (1, 2)} & commands.keys()]
    return [(f"metapp {line.replace('{}', place)}", makes) for line, makes in examples][:most]


def examples_command(
    app: Annotated[
        str,
        typer.Argument(
            metavar="[APP]",
            autocompletion=app_words,
            help="An application; default: two commands of each.",
        ),
    ] = "",
    folder: Annotated[
        Path | None,
        typer.Option(
            "--make", metavar="DIR", callback=check_out_folder, help="Write the input files of the commands to DIR."
        ),
    ] = None,
    json: JsonFlag = False,
) -> None:
    """Print commands that can be run as printed, five per application, and the result of each.

    --make writes their input files, which are small, synthetic and no training data.
    The output is a shell script.

    Example: metapp examples brdf --make example-inputs
    """
    known = sorted(registry().examples)
    if app and app not in known:
        raise typer.BadParameter(f"'{app}': expected one of {', '.join(known)}.{did_you_mean(app, known)}")
    apps, files = [app] if app else known, list[Path]()
    if folder:
        from data_tools.synthetic.examples import EXAMPLES, write_example

        files = [file for name in apps if name in EXAMPLES for file in write_example(name, folder)]
    examples = {name: example_lines(name, folder or EXAMPLE_INPUTS_FOLDER, None if app else 2) for name in apps}
    if json:
        commands = [{"app": name, "command": line, "makes": makes} for name in apps for line, makes in examples[name]]
        print_json({"files": [str(file) for file in files], "commands": commands})
        return
    first = (
        []
        if folder
        else [(f"metapp examples {f'{app} ' if app else ''}--make {EXAMPLE_INPUTS_FOLDER}", "the input files, first")]
    )
    if needy := [name for name in apps if name in VGG_APPS]:
        first.append(("metapp data vgg", f"what fits of {' and '.join(needy)} read, once: 64 to 550 MB"))
    lines = [*first, *(line for name in apps for line in examples[name])]
    standard_output().print("\n".join(f"# {makes}\n{line}" for line, makes in lines), soft_wrap=True)
    if files:
        say(f"made: {', '.join(map(str, files))}")

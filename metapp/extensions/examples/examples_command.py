"""The command `metapp examples`: commands that work as they are, and the input files that they name.

The input files are drawn on demand by `data_tools.synthetic.examples`; nothing is fitted here.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from metapp.cli.arguments import JsonFlag, app_words, check_out_folder
from metapp.cli.console import print_json, standard_output
from metapp.entries import did_you_mean
from metapp.registry import registry
from metapp.runs.reporter import say

VGG_APPS = ("svbrdf_stationary", "texture")  # applications whose fits read the weights of VGG-16
EXAMPLE_INPUTS_FOLDER = Path("example-inputs")  # where commands expect their input files


def example_lines(app: str, folder: Path, count: int | None = None) -> list[tuple[str, str]]:
    """Return the first commands of an application on input files in a folder, and the result of each in words.

    Args:
        app: the application.
        folder: the folder of the input files.
        count: how many commands to return; None for all.
    """
    place = shlex.quote(str(folder))
    commands, lines = registry().commands, registry().applications[app].examples
    examples = lines.load() if lines else ()
    examples = [example for example in examples if {" ".join(example[0].split()[:n]) for n in (1, 2)} & commands.keys()]
    return [(f"metapp {line.replace('{}', place)}", makes) for line, makes in examples][:count]


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

    --make writes their input files, which are small, synthetic and not used in training.
    The output is a shell script.

    Example: metapp examples brdf --make example-inputs
    """
    app_names = sorted(name for name, application in registry().applications.items() if application.examples)
    if app and app not in app_names:
        raise typer.BadParameter(f"'{app}': expected one of {', '.join(app_names)}.{did_you_mean(app, app_names)}")
    apps, files = [app] if app else app_names, list[Path]()
    if folder:
        from data_tools.synthetic.examples import EXAMPLES, write_example

        files = [file for name in apps if name in EXAMPLES for file in write_example(name, folder)]
    examples = {name: example_lines(name, folder or EXAMPLE_INPUTS_FOLDER, None if app else 2) for name in apps}
    if json:
        commands = [{"app": name, "command": line, "makes": makes} for name in apps for line, makes in examples[name]]
        print_json({"files": [str(file) for file in files], "commands": commands})
        return
    first_lines = (
        []
        if folder
        else [(f"metapp examples {f'{app} ' if app else ''}--make {EXAMPLE_INPUTS_FOLDER}", "the input files, first")]
    )
    if vgg_apps := [name for name in apps if name in VGG_APPS]:
        first_lines.append(("metapp data vgg", f"what fits of {' and '.join(vgg_apps)} read, once: 64 to 550 MB"))
    lines = [*first_lines, *(line for name in apps for line in examples[name])]
    standard_output().print("\n".join(f"# {makes}\n{line}" for line, makes in lines), soft_wrap=True)
    if files:
        say(f"made: {', '.join(map(str, files))}")

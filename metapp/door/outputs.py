"""Records of what is made of fits: exports, outputs, pages, tables, commands, and methods without a network."""

from __future__ import annotations

import importlib.util
from typing import NamedTuple


class Export(NamedTuple):
    """A form that fits are written in for other programs.

    Attributes:
        name: the value of --export.
        apps: the applications whose fits are written in it.
        write: `write(app, theta, path)` for the parameters of one fit without a task axis, or, where `of_surface`,
            `write(surface, path, provenance)`; `path` has no suffix, its last part is the fit's name.
        of_surface: whether it is made of the flat surface that a fit is of.
        holds: the parameters that a file holds; a fit of another network is distilled into them first; () for what is
            made of what a fit evaluates to.
        needs: the module and the package of a library that is not always installed; () for none.
        help: what it is, in a few words.
    """

    name: str
    apps: tuple[str, ...]
    write: str
    of_surface: bool = False
    holds: tuple[str, ...] = ()
    needs: tuple[str, str] | tuple[()] = ()
    help: str = ""

    def missing(self) -> str:
        """One line about a library that is not installed; "" where nothing is missing."""
        if not self.needs or importlib.util.find_spec(self.needs[0]):
            return ""
        return f'--export {self.name} needs {self.needs[1]}: pip install "metapp[export]"'


class FileExport(NamedTuple):
    """What `metapp export` makes of another thing than a run, such as files of measurements.

    Attributes:
        names: the values of KIND.
        files: what it is made of, in words.
        write: `write(path, kind, folder, quiet) -> paths`, those of the files that it has written to the folder;
            ValueError where it can make nothing of `path`, BadOption where a file is there already.
    """

    names: tuple[str, ...]
    files: str
    write: str


class Output(NamedTuple):
    """Something that a run makes of each task where its option is given.

    Attributes:
        app: the application.
        option: the application's own option that asks for it.
        output: `output(app, task, theta, value) -> metapp.learning.pictures.Rendered`.
        examples: as of the application, after its own.
    """

    app: str
    option: str
    output: str
    examples: tuple[tuple[str, str], ...] = ()


class PictureMeasure(NamedTuple):
    """A measure of pictures of fits against their references, a row of the table `image`.

    Attributes:
        name: of the row.
        apps: the applications whose pictures it is of.
        measure: `measure(compared) -> float` of a `metapp.learning.pictures.Compared`; NaN where it has none.
        note: what it is, in a few words.
        source: `source() -> str`, by which package and version; ValueError where that is missing. "" where metapp does.
        more_is_better: whether a higher value is better.
    """

    name: str
    apps: tuple[str, ...]
    measure: str
    note: str
    source: str = ""
    more_is_better: bool = False


class FitMethod(NamedTuple):
    """A method of fits in the Python API.

    Attributes:
        name: of the method.
        method: a function whose first argument is a `metapp.runs.api.Fit`.
    """

    name: str
    method: str


class Page(NamedTuple):
    """An application's part of interactive pages; without one they show its pictures.

    Attributes:
        app: the application.
        view: `view(app, theta, task) -> metapp.extensions.viewer.view.View`: of a fit, `theta`
            without a task axis, of a task, without data where that is not at hand.
            KeyError where the fit alone is not enough.
    """

    app: str
    view: str


class Plugin(NamedTuple):
    """A plugin for Mitsuba.

    Attributes:
        name: its type in scenes.
        register: a function that registers it, in the active variant and in all that will be.
        row: the name by which an integrator, which takes `max_depth` as `path` does, is compared in tables of pictures
            of transport; "" for none.
        note: what their captions say of it.
    """

    name: str
    register: str
    row: str = ""
    note: str = ""


class Baselines(NamedTuple):
    """Methods without a network.

    Attributes:
        app: the application whose tasks they fit.
        names: the values of --method, of all protocols.
        baselines: `baselines(app) -> tuple of Baseline` under the application's protocol.
    """

    app: str
    names: tuple[str, ...]
    baselines: str


class Table(NamedTuple):
    """A table of `metapp evaluate`.

    Attributes:
        name: the value of --which.
        table: a `metapp.evaluation.rows.Table`.
    """

    name: str
    table: str


class Command(NamedTuple):
    """A command.

    Attributes:
        name: as on the command line.
        command: a function whose parameters typer reads.
        under: the command that it belongs to, as "data"; "" for none.
        bare_is_help: whether it prints its help where nothing is given.
    """

    name: str
    command: str
    under: str = ""
    bare_is_help: bool = False

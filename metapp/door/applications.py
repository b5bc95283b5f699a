"""Records of applications: what they are, their recipes and networks, and what learns."""

from __future__ import annotations

from typing import NamedTuple


class Application(NamedTuple):
    """An application.

    Attributes:
        name: as on the command line.
        app: its subclass of `metapp.learning.app.App`.
        help: the application in a sentence.
        protocols: the values of --observe, the default first; () where there is no choice.
        options: a dataclass, `metapp.options.AppOptions` with its own; None for none.
        examples: what follows `metapp` ({} stands for a folder of input files), and what that makes.
        files: the input files of the examples, `files(app, folder) -> paths written`; "" for none.
        needs_vgg: whether its fits read features of VGG.
    """

    name: str
    app: str
    help: str = ""
    protocols: tuple[str, ...] = ()
    options: type | None = None
    examples: tuple[tuple[str, str], ...] = ()
    files: str = ""
    needs_vgg: bool = False


class Chosen(NamedTuple):
    """The inputs that take a recipe where none is asked for.

    Attributes:
        formats: the names of the formats that such inputs have.
        has: what these inputs have and the application's others lack, in words.
        tensor: the one that their tasks alone hold; "" where there is none, and data sets do not choose it.
        without: a tensor that their tasks do not hold: another recipe is chosen by it; "" for none.
        tells: the function `tells(path) -> bool` of the formats' modules, which sources these are; "" for all. Where
            there is no such tensor, the one of this name and `_task` tells which tasks in memory are.
        paradigms: those that its checkpoints serve; () for all.
        lacks: a function `lacks() -> str` of what it needs on a machine and does not find, in a line; "" for none.
    """

    formats: tuple[str, ...]
    has: str
    tensor: str = ""
    without: str = ""
    tells: str = ""
    paradigms: tuple[str, ...] = ()
    lacks: str = ""


class Recipe(NamedTuple):
    """A recipe of an application.

    Attributes:
        app: its name.
        name: the value of --recipe.
        recipe: a `metapp.learning.recipe.Recipe`.
        protocol: that it is for; "" where there is but one.
        chosen: the inputs that choose it; None where it must be named.
        checkpoints: the package whose folder <name> holds its checkpoints; "" for those that ship.
    """

    app: str
    name: str
    recipe: str
    protocol: str = ""
    chosen: Chosen | None = None
    checkpoints: str = ""


def recipes_in(app: str, table: str, *names: str, protocols: tuple[str, ...] = ()) -> tuple[Recipe, ...]:
    """The recipes of an application that a table holds by name, or by protocol and name."""
    if not protocols:
        return tuple(Recipe(app, name, f"{table}.{name}") for name in names)
    return tuple(Recipe(app, name, f"{table}.{protocol}.{name}", protocol) for protocol in protocols for name in names)


class Network(NamedTuple):
    """A network of an application that has several, told by a fit's parameters.

    Attributes:
        app: the application.
        network: what the application asks of a network.
    """

    app: str
    network: str


class Part(NamedTuple):
    """A part of learned rules.

    Attributes:
        name: as in compositions, adam+curvature.
        part: a class of `metapp.learning.rules.part.Part` that takes no arguments.
    """

    name: str
    part: str


class Rule(NamedTuple):
    """A name of a composition of parts, as of "adam+loss".

    Attributes:
        name: the value of --rule.
        parts: names of parts and of rules, with + between them.
        short: whether it is a name for compositions alone, and no rule by itself.
    """

    name: str
    parts: str
    short: bool = False


class Engine(NamedTuple):
    """Takes steps of learning faster than torch's loop, with the same results.

    Attributes:
        name: of it.
        engine: `engine(compiles) -> metapp.learning.adjoint.Engine`, as of `fastest` there.
    """

    name: str
    engine: str

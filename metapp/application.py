"""An application as metapp knows it before anything of it is imported: names, texts and references, in one object.

Each application that ships makes its object in its package, `metapp/apps/<name>/__init__.py`; extensions add entries to
the object's tables. Classes here that are a `typing.Protocol` are contracts: a function or module with a matching
signature fulfils one without naming it. Their types are types of `metapp.learning`, for mypy alone. A type of a layer
above is `Any`, and the docstring names it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from metapp.entries import Lazy

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from torch import Tensor

    from metapp.learning.app import App
    from metapp.learning.recipe import Recipe  # noqa: F401  (a base class names it as text)
    from metapp.learning.task import Params, Task
    from metapp.options import AppOptions

FactRange = bool | int | tuple[float, float]  # a value of a fact, or the least and the greatest value of a range
Facts = Mapping[str, bool | int]  # what is known of an input before it is read, by name


# Entries of an application's tables, each beside its contract


@dataclass(frozen=True)
class RecipeEntry(Lazy["Recipe"]):
    """A reference to a :class:`metapp.learning.recipe.Recipe`, and the inputs for which it is chosen.

    Attributes:
        inputs: the inputs that the recipe suits, as a noun phrase, such as "one flash photo".
        suits: facts of inputs, each with its value or range; the recipe is chosen for inputs that have all of them,
            unless the user names a recipe. {} if the recipe is only used where it is named.
        paradigms: the paradigms for which the recipe is chosen; () for all.
        describe_missing_file: a reference to a function without arguments that returns a line about a file that the
            recipe needs and that is missing, or ""; None if the recipe needs no file.
    """

    inputs: str = ""
    suits: Mapping[str, FactRange] = field(default_factory=dict)
    paradigms: tuple[str, ...] = ()
    describe_missing_file: Lazy[Callable[[], str]] | None = None


@dataclass(frozen=True)
class Format(Lazy[Any]):
    """A file format that tasks are read from: a reference to a module that finds and reads its files.

    The module has these names:

    - `recognises(path)`, for inputs of fits: returns whether a path is a file of the format, or a folder with such
      files, by suffixes and first bytes;
    - `find(path)`: returns a pair of lists: a `data_tools.readers.input_source.Source` for each task, with all that
      must be known before the task is read, and a line for each file of a folder that is skipped. It raises ValueError
      for a bad path;
    - `read_task(path, ...)`: returns the task; raises ValueError if the file is damaged. It may name keyword arguments,
      all with defaults. Fits pass those that it names of the arguments that :class:`ReadObject` lists, and `content`,
      which is the `content` of the source. The command "data NAME" passes its options and `content`;
    - `UNITS`, if there is a command "data NAME" (a `metapp.options.Converter`): units of the tasks' tensors by name;
    - `entries(paths, folders, split)`, optional, for that command: returns name, group and split of each task as a
      `metapp.storage.shards.ManifestEntry`, by the path of its source; sources without an entry are left out. `folders`
      are the folders that were searched, `split` is the command's option. By default a task is named by its file.

    Attributes:
        inputs: what the files are, in words, for help and errors; "" if fits do not accept them as INPUT, so that the
            module needs no `recognises`.
        data_sets: whether the command "data NAME" also accepts data sets.
        is_self_contained: whether all files of an input lie in its folder; False for scenes, which name other files.
    """

    inputs: str = ""
    data_sets: bool = False
    is_self_contained: bool = True


class MakeAsset(Protocol):
    """A function that makes an asset of a fit: its answer, complete, as people use it.

    >>> import torch
    >>> from metapp.appearance.assets import Texture
    >>> def make_texture(app, theta, task, size):
    ...     return Texture(theta["image"], tiles=False)
    >>> make_texture(None, {"image": torch.zeros(3, 4, 5)}, None, None).size
    (4, 5)
    """

    def __call__(self, app: Any, theta: Params, task: Task, size: tuple[int, int] | None, /) -> Any:
        """Return a :class:`metapp.appearance.assets.Asset`.

        Args:
            app: the application.
            theta: the fit's parameters, without a task axis.
            task: the task that was fitted; without data if its input was not given.
            size: the height and width of the asset, of those that `App.describe_sizes` allows; None for the usual size
                of files.

        Raises:
            KeyError: the asset needs data that the task lacks; commands then look for the input and call again.
            ValueError: the fit has no such asset.
        """
        ...


class ExportAsset(Protocol):
    """A function that writes an asset as files for other programs.

    >>> def write_size(texture, path, provenance):
    ...     height, width = texture.size
    ...     path.with_suffix(".txt").write_text(f"{provenance['task']}: {height} x {width} px")
    """

    def __call__(self, asset: Any, path: Path, provenance: Mapping[str, object], /) -> None:
        """Write an asset.

        Args:
            asset: a :class:`metapp.appearance.assets.Asset` of the type that the export is registered for.
            path: the path of the file, or of the folder of several files, without suffix; its last part is the task's
                name. Its folder may not exist yet.
            provenance: the task's name, as `task`, and the settings of its fit, by the keys of records.

        Raises:
            ValueError: the form cannot hold this asset.
            OSError: the files cannot be written.
        """
        ...


@dataclass(frozen=True)
class Export(Lazy[ExportAsset]):
    """A form in which assets are written for other programs: a reference to a function.

    Attributes:
        holds: the names of the parameters that the form can hold; fits with another network are distilled into these
            first. () if the form is made of what any network evaluates to.
        needs: the module and the package of a library that the function needs and that is not always installed; ()
            for none.
    """

    holds: tuple[str, ...] = ()
    needs: tuple[str, str] | tuple[()] = ()


class EmbeddedSet(Protocol):
    """A module that draws an application's embedded data set.

    It may have further names:

    - `VERSION`, an integer that is raised when the drawn values change;
    - `units_of(**options)`, the units of a set that is drawn with these options, in place of `UNITS`;
    - `BESIDE`, the name of a tensor and a suffix: this tensor of each task is also written as a file beside the task's
      shard;
    - `FILES`, other forms of the set by name, each a pair: a function `write(folder, split, count, seed)`, which yields
      the names of the files that it writes, and the size of one file in bytes;
    - a constant for each option, in capitals: its default.

    Attributes:
        COUNTS: the number of tasks of the default set, by split ("train", "test").
        UNITS: units or encodings of the tasks' tensors in words, by name.
        synthetic_tasks: a function `synthetic_tasks(split, count, seed, **options)` that yields so many tasks. A seed
            gives equal tasks on every machine; further parameters are named like options of `metapp data synth`, see
            `metapp.cli.synthesis_options`.

    >>> from metapp.registry import registry
    >>> registry().applications["brdf"].synthetic.load().COUNTS
    {'train': 80, 'test': 20}
    """

    COUNTS: Mapping[str, int]
    UNITS: Mapping[str, str]
    synthetic_tasks: Callable[..., Iterator[Task]]


@dataclass(frozen=True)
class SyntheticSet(Lazy["EmbeddedSet"]):
    """A reference to the module that draws an application's embedded data set.

    Attributes:
        content: what the set holds, how many tasks, and its size, for help.
    """

    content: str = ""


class ReadObject(Protocol):
    """A function that makes the task of an object in memory, for an application's fits in the Python API.

    >>> import torch
    >>> from metapp.learning.task import Task
    >>> def task_of_object(source, name, size=256, **_):
    ...     if not isinstance(source, torch.Tensor):
    ...         raise ValueError(f"{name}: {type(source).__name__}, expected a tensor [3, H, W].")
    ...     return Task(name, {"image": source[:, :size, :size]})
    >>> task_of_object(torch.zeros(3, 512, 512), "object", observe="reference").data["image"].shape
    torch.Size([3, 256, 256])
    """

    def __call__(self, source: object, name: str, /, **arguments: Any) -> Task:
        """Return the task of an object.

        Args:
            source: the object, of any type but a path or text.
            name: the task's name, with which error messages begin.
            **arguments: `observe`, the value of --observe; the options about INPUT that the user gave; and, if
                `App.read_size` is not 0, the sizes to read to, in px: `size`, the side of pictures, `rows`, the rows of
                panoramas, and `least`, the least side of photographs. The function must accept further ones as `**_`.

        Raises:
            ValueError: the application fits no objects of this type, or the values are not usable.
        """
        ...


class MergeInputs(Protocol):
    """A function that makes one task of all inputs, called if the option of its key is given, such as --shutter.

    The option is a field of the application's options (`metapp.options.AppOptions`), about INPUT.

    >>> import torch
    >>> from pathlib import Path
    >>> from metapp.learning.task import Task
    >>> def merge(paths, value, rows=64):
    ...     return Task(paths[0].stem, {"map": torch.ones(3, rows, 2 * rows) * value})
    >>> merge([Path("a.png"), Path("b.png")], 0.5, rows=2).name
    'a'
    """

    def __call__(self, paths: Sequence[Path], value: Any, /, **arguments: Any) -> Task:
        """Return the one task of all files.

        Args:
            paths: the files that the application's formats find in the inputs, in the order of the inputs.
            value: the option's value, with the type of its field.
            **arguments: the arguments that :class:`ReadObject` lists, as far as the function names them.

        Raises:
            ValueError: the files do not belong together, are damaged, or do not go with the option's value.
        """
        ...


class RenderFit(Protocol):
    """A function that makes further pictures of a fit, called if the option of its key is given, such as --render.

    The option is a field of the application's options (`metapp.options.AppOptions`), about OUTPUT.

    >>> import torch
    >>> from metapp.appearance.pictures import Picture, ScenePictures
    >>> def mean_colour(app, task, theta, side):
    ...     picture = theta["map"].mean((1, 2)).expand(side, side, 3)
    ...     return ScenePictures({"mean": Picture(picture, "radiance")}, [f"mean: {side} px"])
    >>> mean_colour(None, None, {"map": torch.ones(3, 8, 16)}, 4).files["mean"].pixels.shape
    torch.Size([4, 4, 3])
    """

    def __call__(self, app: App, task: Task, theta: Params, value: Any, /) -> Any:
        """Return a `metapp.appearance.pictures.ScenePictures`: pictures by file name, and lines to print.

        Args:
            app: the application.
            task: the task that was fitted.
            theta: the fit's parameters, without a task axis.
            value: the option's value, with the type of its field.

        Raises:
            ValueError: the task lacks data that the pictures need.
        """
        ...


class ViewFit(Protocol):
    """A function that makes the interactive view of a fit with one type of asset, for a page of the viewer.

    >>> from metapp.extensions.viewer.view import View
    >>> def view(fit):
    ...     return View("pictures", pictures={"fit": fit.asset.pixels.permute(1, 2, 0)})
    """

    def __call__(self, fit: Any, /) -> Any:
        """Return the view of a fit, a :class:`metapp.extensions.viewer.view.View`.

        Args:
            fit: the fit, a :class:`metapp.runs.fit.Fit`; its task has no data if its input is not at hand.

        Raises:
            KeyError: the view needs data that the task lacks.
        """
        ...


class MakeBaselines(Protocol):
    """A function that makes the baselines of an application; several entries may name one function.

    >>> def baselines(app):
    ...     return ()
    """

    def __call__(self, app: Any, /) -> tuple[Any, ...]:
        """Return the application's baselines, among them the one of the entry's key.

        Each is a :class:`metapp.extensions.baselines.baseline.Baseline`.

        Args:
            app: the application's network and sizes, at the recipe of the fits.
        """
        ...


class DescribeTensors(Protocol):
    """A function that tells facts about a task by its tensors, by which recipes are chosen.

    >>> def facts_of(tensors):
    ...     return {"samples": 0 if tensors["angles"] is None else tensors["angles"].shape[1]}
    """

    def __call__(self, tensors: Mapping[str, Tensor | None], /) -> Facts:
        """Return facts about a task.

        Args:
            tensors: tensors by name, or None in place of a tensor of which only the name is known, as in a data set.
        """
        ...


NO_OPTIONS: Lazy[type[AppOptions]] = Lazy("metapp.options:AppOptions")
NO_PRESENTER: Lazy[type[Any]] = Lazy("metapp.appearance.presenter:Presenter")


@dataclass(kw_only=True, eq=False)
class Application:
    """All that metapp knows of an application. Extensions add entries to its tables, and set references that are None.

    Attributes:
        name: the name on the command line.
        title: the name in tables and pictures.
        help: what the application fits, in one sentence.
        app: the class of its fits; each recipe holds an instance of it.
        options: the application's own options.
        assets: functions that make assets of fits, by the name of the type of asset, of which exports and pages are
            registered; the first one is what a fit is for. {} for fits that people only measure.
        presenter: what people look at, a `metapp.appearance.presenter.Presenter`; that class itself shows nothing.
        facts: tells facts about a task by its tensors; None if no recipe depends on facts. A fact of the name of an
            observation that is False says that the task lacks what fits would observe.
        read_object: makes the task of an object in memory; None if only files are read.
        synthetic: the module that draws the embedded data set; None without such a set.
        examples: commands that work as they are: pairs of the words after `metapp`, in which {} is the folder of
            inputs, and of a line about what they produce.
        recipes: recipes by name, or by pairs of an observation and a name if fits can observe different things. An
            observation is a value of --observe; the default stands first. "quick" is one of the recipes.
        formats: formats of input files. The command "data NAME" converts the files of the format NAME.
        baselines: functions that make methods without a network, by the name of each method.
        merges: functions that make one task of all inputs, by the name of an option about INPUT that calls for it.
        outputs: functions that make further pictures of a fit, by the name of an option about OUTPUT that calls for it.
        networks: networks that users do not choose, as the parameters of a fit tell which one they belong to. Of the
            applications that ship, brdf has such networks, `metapp.apps.brdf.brdf_network.BrdfNetwork`.

    >>> from metapp.registry import registry
    >>> illumination = registry().applications["illumination"]
    >>> illumination.observations, list(illumination.recipes_observing("photo"))
    (('reference', 'photo'), ['quick', 'full', 'paper'])
    """

    name: str
    title: str
    help: str
    app: Lazy[type[App]]
    options: Lazy[type[AppOptions]] = NO_OPTIONS
    assets: dict[str, Lazy[MakeAsset]] = field(default_factory=dict)
    presenter: Lazy[type[Any]] = NO_PRESENTER
    facts: Lazy[DescribeTensors] | None = None
    read_object: Lazy[ReadObject] | None = None
    synthetic: SyntheticSet | None = None
    examples: Lazy[Sequence[tuple[str, str]]] | None = None
    recipes: dict[str | tuple[str, str], RecipeEntry] = field(default_factory=dict)
    formats: dict[str, Format] = field(default_factory=dict)
    baselines: dict[str, Lazy[MakeBaselines]] = field(default_factory=dict)
    merges: dict[str, Lazy[MergeInputs]] = field(default_factory=dict)
    outputs: dict[str, Lazy[RenderFit]] = field(default_factory=dict)
    networks: dict[str, Lazy[Any]] = field(default_factory=dict)

    def named_recipes(self) -> Iterator[tuple[str, str, RecipeEntry]]:
        """Yield what fits observe, "" if all observe the same, the name and the entry of each recipe."""
        for key, entry in self.recipes.items():
            observation, name = key if isinstance(key, tuple) else ("", key)
            yield observation, name, entry

    @property
    def observations(self) -> tuple[str, ...]:
        """The values of --observe, what fits can observe, the default first; () if all fits observe the same."""
        return tuple(dict.fromkeys(observation for observation, _, _ in self.named_recipes() if observation))

    @property
    def default_observation(self) -> str:
        """The default value of --observe; "" if all fits observe the same."""
        return next(iter(self.observations), "")

    @property
    def recipe_names(self) -> list[str]:
        """The names of all recipes, each once."""
        return list(dict.fromkeys(name for _, name, _ in self.named_recipes()))

    def recipes_observing(self, observation: str = "") -> dict[str, RecipeEntry]:
        """Return the recipes whose fits observe something, by name; "" stands for the default observation."""
        wanted = observation or self.default_observation
        return {name: entry for observed, name, entry in self.named_recipes() if observed == wanted}

    @property
    def input_formats(self) -> dict[str, Format]:
        """The formats that fits accept as INPUT, by name, sorted.

        >>> from metapp.registry import registry
        >>> list(registry().applications["texture"].input_formats)
        ['images']
        """
        return {name: form for name, form in sorted(self.formats.items()) if form.inputs}

    def describe_tensors(self, tensors: Mapping[str, Tensor | None]) -> Facts:
        """Return facts about a task by its tensors; see :class:`DescribeTensors`."""
        return self.facts.load()(tensors) if self.facts else {}

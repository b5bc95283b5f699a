"""The contracts of the registry's tables: what the object that an entry names takes and returns.

A class here is a `typing.Protocol`: a function or module with a matching signature fulfils it without naming it. Tables
of :class:`metapp.registry.Registry` name their contracts, so that mypy checks calls of the objects that they load.
Contracts that are base classes are elsewhere: `metapp.learning.app.App`, `metapp.appearance.presenter.Presenter`,
`metapp.learning.rules.Part` and `metapp.extensions.baselines.baseline.Baseline`.

The types are types of `metapp.learning`, for mypy alone: nothing is imported at run time. A type of a layer above is
`Any`, and the docstring names it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from torch import Generator

    from metapp.learning.adjoint import Loss, Steps, UpdateRule
    from metapp.learning.app import App
    from metapp.learning.learn import DescentState
    from metapp.learning.recipe import OuterLoop
    from metapp.learning.rules import Part as Part
    from metapp.learning.task import Params, Task, Tasks

    SceneDict = dict[str, Any]  # a scene of Mitsuba as JSON holds it


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


class ExportParameters(Protocol):
    r"""A function that writes the parameters of a fit as a file for other programs.

    >>> def write_sizes(app, theta, path):
    ...     lines = [f"{name} {tuple(value.shape)}" for name, value in theta.items()]
    ...     path.with_suffix(".txt").write_text("\n".join(lines))
    """

    def __call__(self, app: Any, theta: Params, path: Path, /) -> None:
        """Write a fit.

        Args:
            app: the application.
            theta: the fit's parameters, without a task axis; if `Export.holds` lists names, exactly these.
            path: the path of the file without suffix; its last part is the task's name. Its folder may not exist yet.

        Raises:
            ValueError: the form cannot hold this fit.
            OSError: the file cannot be written.
        """
        ...


class ExportSurface(Protocol):
    """A function that writes the flat surface of a fit, its maps, as files for other programs.

    >>> def write_size(surface, path, provenance):
    ...     height, width = surface.size
    ...     path.with_suffix(".txt").write_text(f"{provenance['task']}: {height} x {width} texels")
    """

    def __call__(self, surface: Any, path: Path, provenance: Mapping[str, object], /) -> None:
        """Write a surface.

        Args:
            surface: a :class:`metapp.appearance.surface.Surface` that `Presenter.surface` returned.
            path: the path of the file, or of the folder of several files, without suffix; its last part is the task's
                name.
            provenance: the task's name, as `task`, and the settings of its fit, by the keys of records.

        Raises:
            ValueError: the form cannot hold this surface.
            OSError: the files cannot be written.
        """
        ...


class ExportFiles(Protocol):
    """A function for `metapp export` of files that are no fits: it writes them in another form.

    >>> def write(path, kind, folder, quiet):
    ...     target = folder / f"{path.stem}.{kind}"
    ...     target.write_bytes(path.read_bytes())
    ...     return [target]
    """

    def __call__(self, path: Path, kind: str, folder: Path, quiet: bool, /) -> Iterable[Path]:
        """Write a file, or the files of a folder, in the form, and return the paths that were written.

        Args:
            path: the file or folder.
            kind: the form, which is the entry's key.
            folder: the folder to write to; it may not exist yet.
            quiet: whether to show no progress.

        Raises:
            ValueError: no file can be written in this form, a file is damaged, or a target exists already.
        """
        ...


class ViewFit(Protocol):
    """A function that makes the interactive view of an application's fits for a page of the viewer.

    >>> import torch
    >>> from metapp.extensions.viewer.view import View
    >>> def view(presenter, theta, task):
    ...     return View("pictures", pictures={"fit": theta["image"].permute(1, 2, 0)})
    >>> view(None, {"image": torch.zeros(3, 4, 5)}, None).pictures["fit"].shape
    torch.Size([4, 5, 3])
    """

    def __call__(self, presenter: Any, theta: Params, task: Task, /) -> Any:
        """Return the view of a fit, a :class:`metapp.extensions.viewer.view.View`.

        Args:
            presenter: the application's :class:`metapp.appearance.presenter.Presenter`.
            theta: the fit's parameters, without a task axis.
            task: the task that was fitted; without data if its file is not available.

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
            app: the application under its protocol.
        """
        ...


class MakeTable(Protocol):
    """A function that makes a table of `metapp evaluate`.

    >>> from metapp.evaluation.table import Table
    >>> def counts(evaluation):
    ...     return Table(evaluation.title, "Tasks", (), [{"tasks": len(evaluation.tasks)}])
    """

    def __call__(self, evaluation: Any, /) -> Any:
        """Return the :class:`metapp.evaluation.table.Table` of an application, without rows if none apply.

        Args:
            evaluation: a :class:`metapp.evaluation.evaluation_run.EvaluationRun`: the application under a protocol,
                its tasks and runs; it makes the fits that the table asks for.
        """
        ...


class FitMethod(Protocol):
    """A function that becomes a method of fits in the Python API, under the name of the entry's key.

    >>> def first_word(fit):
    ...     return fit.name.split("-")[0]
    """

    def __call__(self, fit: Any, /, *arguments: Any, **keywords: Any) -> object:
        """Return the result of the method.

        Args:
            fit: a :class:`metapp.runs.fit.Fit`.
            *arguments, **keywords: the further arguments of the method's call.
        """
        ...


class MakeSteps(Protocol):
    """A function that makes the steps of a rule down a loss, faster than torch where it can; the hook "steps".

    >>> from metapp.learning.adjoint import torch_steps
    >>> def steps(rule, loss, theta, order, *, compiles=False):
    ...     return torch_steps(rule, loss, theta, order)
    """

    def __call__(self, rule: UpdateRule, loss: Loss, theta: Params, order: int, /, *, compiles: bool = False) -> Steps:
        """Return steps with the results of :func:`metapp.learning.adjoint.torch_steps`, up to rounding.

        Args:
            rule: the rule with its hyperparameters.
            loss: the loss of the tasks.
            theta: parameters [T, ...] with the shapes that steps will see; their values are not read.
            order: 2 differentiates the gradient of a step in the vector-Jacobian product, 1 treats it as a constant.
            compiles: whether the steps are so many that compiling code for them pays.
        """
        ...


class DescendOuterLoss(Protocol):
    """A function that takes the outer steps of a training faster than torch where it can; the hook "outer_loop".

    >>> def descend_outer_loss(paradigm, outer_loop, params, tasks, rng, since=None):
    ...     return None
    """

    def __call__(
        self,
        paradigm: Any,
        outer_loop: OuterLoop,
        params: Params,
        tasks: Tasks,
        rng: Generator,
        since: DescentState | None = None,
        /,
    ) -> Iterator[DescentState] | None:
        """Descend the outer loss of a paradigm's training, with the results of the loop in torch up to rounding.

        Args:
            paradigm: the :class:`metapp.paradigms.paradigm.Paradigm` that fits, whose phi is trained.
            outer_loop: the settings of the outer loop.
            params: the phi before the first step, a flat tree.
            tasks: the training tasks.
            rng: the source of all random numbers. After each state that is yielded, it must be in the state in which
                the loop in torch would leave it.
            since: the state of an earlier descent, which is continued.

        Returns:
            The state before the first step, then states after some of the steps, among them each step at which
            `outer_loop.validate_every` asks for a validation, and the last. The loss of a state holds the losses of all
            steps since the state before, one step after the other, and `names` the names of their tasks. A step whose
            loss is not finite ends the steps before a state. None if the function cannot take these steps.
        """
        ...


class CheckScene(Protocol):
    """A function that checks the scene of a data set before Mitsuba loads it; the hook "scene".

    >>> def check(scene):
    ...     if "xml" in scene:
    ...         raise ValueError("a scene in XML, expected a dictionary.")
    ...     return scene
    """

    def __call__(self, scene: SceneDict, /) -> SceneDict:
        """Return the scene, in which nothing is left that Mitsuba may not load.

        Args:
            scene: a dictionary of type "scene", as JSON holds it.

        Raises:
            ValueError: the scene holds a plugin or a file that scenes of data sets may not hold.
        """
        ...


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
            gives equal tasks on every machine; further parameters are options of `metapp data synth`.

    >>> from metapp.registry import registry
    >>> registry().synthetic["brdf"].load().COUNTS
    {'train': 80, 'test': 20}
    """

    COUNTS: Mapping[str, int]
    UNITS: Mapping[str, str]
    synthetic_tasks: Callable[..., Iterator[Task]]

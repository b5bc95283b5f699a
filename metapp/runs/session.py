"""What fitting and evaluation share: options, device, and everything that a figure depends on."""

from __future__ import annotations

import contextlib
import platform
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import torch

from metapp.apps import app_names, app_of, presentation_of, protocols_of, recipes_of
from metapp.learning.app import App, ReducedPrecision
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.rules import rule_of
from metapp.paradigms import Job, Paradigm
from metapp.runs import BadOption
from metapp.runs.shipped import FULL, QUICK, full_fits_as_quick, ships
from metapp.runs.timing import seconds_of

THREADS = torch.get_num_threads()  # as the process began


class Options(NamedTuple):
    """The options that all paradigms share; what each means stands in its --help."""

    app: App
    recipe: str
    rule: str
    steps: int | None
    data: Path | None
    out: Path
    checkpoint: Path | None
    seed: int
    device: torch.device
    quiet: bool
    budget: float | None = None  # seconds
    watch: bool = False
    own: Recipe | None = None  # the recipe, where it is none of the application's

    @property
    def job(self) -> Job:
        """What the paradigms work on."""
        recipe = self.own or recipes_of(self.app.name, self.app.protocol)[self.recipe]
        return Job(self.app, recipe, self.rule, self.steps)

    def by(self, paradigm: Paradigm) -> Options:
        """The same for a paradigm: Meta's rule may have a network of its own."""
        recipe = self.job.recipe
        if paradigm.name != "meta" or recipe.training(self.rule).setup is None:
            return self
        return self._replace(app=app_of(self.app.name, recipe, self.app.protocol, rule=self.rule))


def options_of(
    name: str,
    *,
    observe: str = "",
    rule: str = "",
    recipe: str = "",
    own_files_by: str = "",
    steps: int | None = None,
    data: Path | None = None,
    out: Path = Path("runs"),
    checkpoint: Path | None = None,
    seed: int = 0,
    device: str = "auto",
    quiet: bool = False,
    budget: str = "",
    watch: bool = False,
) -> Options:
    """Check what was asked for and put the application at its recipe and protocol.

    Without a recipe a user's own files (by the paradigm `own_files_by`) are fitted by "full", where that ships and no
    data, checkpoint or rule is given; where it is of the size of "quick", by Meta alone, and only if its rule is
    another. All else is by "quick".

    Raises:
        BadOption: something that the application does not have.
        ValueError: no such device.
    """
    check_name(name)
    check_protocol(observe, name)
    recipes = recipes_of(name, observe)
    if not recipe:
        own = bool(own_files_by) and not (data or checkpoint or rule)
        recipe = FULL if own and FULL in recipes and _has_own(name, recipes, own_files_by) else QUICK
    if recipe not in recipes:
        raise BadOption(f"--recipe '{recipe}': expected one of {', '.join(recipes)}.")
    app = app_of(name, recipes[recipe], observe)
    chosen = check_rule(rule, app, recipes[recipe])
    found, seconds = find_device(device, app), seconds_of(budget)
    return Options(app, recipe, chosen, steps, data, out, checkpoint, seed, found, quiet, seconds, watch)


def _has_own(name: str, recipes: Mapping[str, Recipe], paradigm: str) -> bool:
    """Whether fits of "full" by a paradigm differ from those of "quick", and it ships."""
    if full_fits_as_quick(name):
        return paradigm == "meta" and recipes[FULL].rule != recipes[QUICK].rule
    return ships(name, FULL)


class Checkpoint(NamedTuple):
    """A checkpoint, where it came from and a digest of its file ("" where nothing is needed)."""

    prepared: MetaParameters
    source: str
    digest: str


def check_name(name: str) -> None:
    """A usage error that lists the applications where there is none of that name."""
    if name not in app_names():
        raise BadOption(f"'{name}' is not an application; expected one of {', '.join(app_names())}.")


def check_rule(name: str, app: App, recipe: Recipe) -> str:
    """The one name of a rule or composition, the recipe's default where it is empty, or a usage error."""
    if not name:
        return recipe.rule
    try:
        rule = rule_of(name)
        app = app_of(app.name, recipe, app.protocol, rule=rule.name)
        theta = {key: value[0] for key, value in app.init(torch.Generator().manual_seed(0), 1).items()}
        rule.require(app, theta)
    except ValueError as error:
        raise BadOption(f"--rule: {error}") from None
    return rule.name


def check_protocol(protocol: str, name: str) -> None:
    """A usage error where the application of a name has no such protocol."""
    known = protocols_of(name)
    if protocol and protocol not in known:
        expected = f"expects one of {', '.join(known)}" if known else "has one protocol; leave it out"
        raise BadOption(f"--observe '{protocol}': {name} {expected}.")


def is_first_protocol(app: App) -> bool:
    """Whether the application is under its first protocol, or has no other."""
    return app.protocol in ("", *protocols_of(app.name)[:1])


def observe_of(app: App) -> dict[str, str]:
    """The protocol as records, rows and headers of checkpoints say it: nothing where there is none."""
    return {"observe": app.protocol} if app.protocol else {}


def precision_of(app: App, device: torch.device, steps: int = 1) -> dict[str, str]:
    """What so many steps compute in other than float32, as records and headers of checkpoints say it, if anything."""
    precision = app.precision(device) if steps and isinstance(app, ReducedPrecision) else ""
    return {"precision": precision} if precision else {}


def name_of(app: App) -> str:
    """The application's name and its protocol, if any: illumination photo."""
    return f"{app.name} {app.protocol}".rstrip()


def title_of(app: App) -> str:
    """The application's title in tables and pictures, with its protocol, if any."""
    title = presentation_of(app).title
    return f"{title} ({app.protocol})" if app.protocol else title


def caption_of(app: App) -> str:
    """What a table says about its errors."""
    seen = {"fits see": app.protocol} if app.protocol else {}
    conditions = "".join(f"; {key}: {value}" for key, value in (seen | app.conditions()).items())
    return (
        f"error: {presentation_of(app).measure}{f' x{app.traits.scale:g}' if app.traits.scale != 1 else ''}{conditions}"
    )


def threads_of(app: App) -> int:
    """The threads that an application's fits run on, whatever ran before: threads that share little work wait."""
    return 1 if app.traits.single_threaded else THREADS


@contextlib.contextmanager
def threads(count: int | None) -> Iterator[None]:
    """Have torch work with so many threads; afterwards with as many as before."""
    before = torch.get_num_threads()
    torch.set_num_threads(count or before)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def find_device(name: str, app: App) -> torch.device:
    """The device; auto is CUDA where there is one, but the CPU where the application is single-threaded."""
    if name not in ("auto", "cpu", "cuda"):
        raise BadOption(f"--device '{name}': expected auto, cpu or cuda.")
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("--device cuda: PyTorch finds no CUDA device; use --device cpu or install a CUDA build.")
    automatic = "cuda" if torch.cuda.is_available() and not app.traits.single_threaded else "cpu"
    return torch.device(automatic if name == "auto" else name)


def make_folder(folder: Path) -> None:
    """Make a folder to write to, before any work is done.

    Raises:
        ValueError: it cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):  # nameless, as other runs may write there, too
            pass
    except OSError as error:
        raise ValueError(f"--out {folder}: cannot be written to ({error.strerror}); choose another folder.") from None


def versions() -> dict[str, str]:
    """The versions that a figure depends on."""
    return {
        "metapp": metadata.version("metapp"),
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }


def settings_of(options: Options, paradigm: Paradigm, checkpoint: Checkpoint, label: str) -> dict[str, Any]:
    """Everything that a run's figures depend on: what its records carry, and their key."""
    recipe = options.job.recipe
    adam, guard = paradigm.adam(options.job, checkpoint.prepared), paradigm.guard(options.job)
    return {
        "app": options.app.name,
        **observe_of(options.app),
        "paradigm": paradigm.name,
        "rule": options.rule if paradigm.name == "meta" else ("adam" if adam else "none"),
        "steps": paradigm.count(options.job),
        "batch": recipe.batch,
        "adam": adam and asdict(adam),
        **({"guard": asdict(guard)} if guard else {}),
        **({"budget": options.budget} if options.budget is not None else {}),
        "start": checkpoint.digest,
        "data": label,
        "recipe": options.recipe,
        "seed": options.seed,
        "device": str(options.device),
        "versions": versions(),
        **options.app.conditions(),
        **precision_of(options.app, options.device, paradigm.count(options.job)),
    }

"""The registry: names are unique, and an extension with any error is left out as a whole and said."""

import functools
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import is_dataclass
from pathlib import Path

import pytest

from metapp import application as contracts
from metapp import contents as core
from metapp import registry as module
from metapp.application import Export
from metapp.entries import Lazy
from metapp.extensions import contents
from metapp.registry import WITHOUT_VARIABLE, Registry, registry

ROOT = Path(__file__).parent.parent
RUN = "import sys\nfrom metapp.cli import main\nmain()"
GOOD = "from metapp.application import Application, Export, RecipeEntry\nfrom metapp.entries import Lazy\n"
GOOD += "from metapp.registry import Command, TableEntry\n\n\ndef register(registry):\n"
GOOD += '    brdf, registry.tables["strange"] = registry.applications["brdf"], TableEntry("math:gcd")\n'

# the end of a module whose first line registers something good -> why it is left out
BROKEN = {
    'registry.tables["more"] = TableEntry("nothing_at_all:TABLE")': "ImportError: nothing_at_all:TABLE: no such module",
    'brdf.baselines["mine"] = Lazy("nothing.at_all:read")': "ModuleNotFoundError: No module named 'nothing'",
    'registry.commands["more"] = Command("math:pi")': "TypeError: commands more: math:pi is not a function",
    'registry.commands["more"] = Command("math:nothing")': "ImportError: math:nothing cannot be loaded: Attribute",
    'registry.commands["more"] = Command("antigravity_exit:run")': (
        "antigravity_exit:run cannot be loaded: SystemExit: 7"
    ),
    'registry.exports["reflectance", "glsl"] = Export("math:gcd")': (
        "ValueError: exports reflectance glsl: registered by stranger, but metapp has registered it already"
    ),
    'registry.exports.update({("reflectance", "glsl"): Export("math:gcd")})': "but metapp has registered it already",
    'brdf.synthetic = Lazy("math:gcd")': "ValueError: fields of brdf synthetic: registered by stranger, but metapp has",
    'brdf.pages = Lazy("math:gcd")': "ValueError: fields of brdf pages: expected one of name, title, help",
    'registry.hooks["steps"] = Lazy("math:gcd")': "ValueError: hooks steps: registered by stranger, but metapp has",
    'registry.hooks["stepps"] = Lazy("math:gcd")': "ValueError: hooks stepps: expected one of steps, scene",
    'registry.rules["ridge"] = Lazy("math:gcd")': (
        "ValueError: rules ridge: registered by stranger, but metapp has registered it"
    ),
    'registry.commands["data merl"] = Command("math:gcd")': "commands data merl: registered by stranger, but metapp",
    'registry.commands["meta"] = Command("math:gcd")': "ValueError: commands meta: registered by stranger, but metapp",
    'brdf.recipes["mine"] = RecipeEntry("math:gcd", suits={"samples": (1, 200)})': (
        "ValueError: recipes of brdf for inputs of samples (1, 200): registered by stranger, "
        "but metapp has registered it already"
    ),
    'registry.exports["surface", "mine"] = "math:gcd"': "TypeError: exports surface mine: a str, expected Export",
    'registry.exports["surface", "mine"] = Lazy("math:gcd")': "exports surface mine: a Lazy, expected Export",
    'registry.add(Application(name="mine", title="", help="", app=Lazy("math"), options=Lazy("nothing_at_all:A")))': (
        "ImportError: nothing_at_all:A: no such module"
    ),
    'registry.exports["mine"] = Export("math:gcd")': "TypeError: exports 'mine': expected a pair of names",
    'brdf.baselines["mine", "yours"] = Lazy("math:gcd")': "TypeError: baselines of brdf ('mine', 'yours'): expected",
    'registry.tables[""] = TableEntry("math:gcd")': "TypeError: tables '': expected a name",
    "brdf.recipes = {}": "ValueError: fields of brdf recipes: registered by stranger, but metapp has",
    "registry.commands = {}": "FrozenInstanceError: cannot assign to field 'commands'",
    "registry.steps = 7": "FrozenInstanceError: cannot assign to field 'steps'",
    "registry.smells": "AttributeError: 'Registry' object has no attribute 'smells'",
    "raise SystemExit(7)": "SystemExit: 7",
    "raise BaseException('no\\n  more')": "BaseException: no more",
}
# whole modules
DEAD = {
    "import nothing_at_all": "ModuleNotFoundError: No module named 'nothing_at_all'",
    "import sys\nsys.exit(7)": "SystemExit: 7",
    "class Stop(BaseException): ...\nraise Stop('here')": "Stop: here",
    "def register(registry": "SyntaxError: ",
    "": "AttributeError: module '{name}' has no attribute 'register'",
    "register = 7": "TypeError: 'int' object is not callable",
}
REASONS = {f"{GOOD}    {line}\n": reason for line, reason in BROKEN.items()} | DEAD


def install(folder: Path, text: str, name: str = "stranger", point: str = "") -> None:
    """Write a package of one module, and its entry point, which names that by default."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{module.ENTRY_POINT_GROUP}]\n{name} = {point or f'{name}_module'}\n")
    (folder / f"{name}_module.py").write_text(text)
    (folder / "antigravity_exit.py").write_text("raise SystemExit(7)\n")


@pytest.fixture
def install_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Registry]]:
    """Installs modules as packages for as long as a test takes; returns the registry that has them."""
    monkeypatch.syspath_prepend(tmp_path)
    fresh = functools.cache(module._build_registry.__wrapped__)
    monkeypatch.setattr(module, "_build_registry", fresh)

    def add(text: str | None = None, name: str = "stranger") -> Registry:
        if text is not None:
            install(tmp_path, text, name)
        fresh.cache_clear()
        return registry()

    before = set(sys.modules)
    yield add
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


@pytest.mark.parametrize("point", ["stranger_module", "stranger_module:register"])
def test_another_package_adds_its_entries(
    install_packages: Callable[..., Registry], point: str, tmp_path: Path
) -> None:
    """The package's entry point names a module or a function."""
    install(tmp_path, GOOD, point=point)
    loaded_registry = install_packages()
    assert loaded_registry is registry()
    assert loaded_registry.problems == {}
    assert loaded_registry.extensions["stranger"] == loaded_registry.owner("tables", "strange") == "stranger"
    assert loaded_registry.tables["strange"].load()(12, 18) == 6
    assert list(loaded_registry.tables)[-1] == "strange"  # what ships comes first


@pytest.mark.parametrize(("text", "reason"), REASONS.items(), ids=REASONS)
def test_a_broken_extension_is_left_out_as_a_whole(
    text: str, reason: str, install_packages: Callable[..., Registry]
) -> None:
    before = registry()
    loaded_registry = install_packages(text)
    assert reason.format(name="stranger_module") in loaded_registry.problems.pop("stranger of stranger")
    assert loaded_registry.problems == {}
    assert repr(loaded_registry.all_tables()) == repr(before.all_tables())
    assert "stranger" not in loaded_registry.extensions


def test_of_two_packages_with_one_name_the_second_is_left_out(install_packages: Callable[..., Registry]) -> None:
    install_packages(GOOD, "a")
    loaded_registry = install_packages(GOOD, "b")
    assert loaded_registry.problems == {
        "b of b": "ValueError: tables strange: registered by b, but a has registered it already"
    }
    assert loaded_registry.owner("tables", "strange") == "a"


def test_ctrl_c_is_no_error_of_an_extension(install_packages: Callable[..., Registry]) -> None:
    with pytest.raises(KeyboardInterrupt):
        install_packages("raise KeyboardInterrupt")


def test_extensions_disabled_by_the_environment_leave_no_entries(
    install_packages: Callable[..., Registry], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT_VARIABLE, "viewer, stranger,dead")
    install_packages(GOOD)
    loaded_registry = install_packages("import nothing_at_all", "dead")
    assert loaded_registry.problems == {}
    assert not loaded_registry.extensions.keys() & {"viewer", "stranger", "dead"}
    assert not {"strange"} & loaded_registry.tables.keys()
    assert "view" not in loaded_registry.commands


def test_metapp_works_beside_broken_packages(tmp_path: Path) -> None:
    """A new process says why they are left out."""
    for i, text in enumerate(REASONS):
        install(tmp_path, text, f"broken{i}")
    command = '    registry.commands["good"] = Command("good_module:run")\n\n\ndef run(x: int | str): ...\n'
    install(tmp_path, GOOD + command, "good")

    def metapp(*words: str) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join(filter(None, [str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")]))
        environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "200"}
        return subprocess.run(
            [sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=False, env=environment
        )

    assert "overfit" in metapp("--help").stdout
    result = metapp("doctor", "--json")  # its exit status says whether something fails, such as a missing download
    assert result.returncode in (0, 1)
    count = len(REASONS)
    assert result.stderr.count("; it is left out.\n") == len(result.stderr.splitlines()) == count
    name = f"broken{list(BROKEN).index('raise SystemExit(7)')}"
    assert f"warning: extension {name} of {name}: SystemExit: 7; it is left out.\n" in result.stderr
    extensions = json.loads(result.stdout)["extensions"]
    assert "good of good" in extensions
    assert (
        "broken5 of broken5 (left out: ValueError: exports reflectance glsl: registered by broken5, but" in extensions
    )
    assert extensions.count("left out") == count
    listed = metapp("--help")
    assert "good" not in listed.stdout  # typer makes no command of its function


def test_entries_of_other_packages_that_cannot_be_loaded_are_left_out_with_a_warning(
    install_packages: Callable[..., Registry],
) -> None:
    loaded_registry = install_packages(f'{GOOD}    brdf.networks["strange"] = Lazy("math:nothing")\n')
    networks = loaded_registry.applications["brdf"].networks
    with pytest.warns(
        UserWarning, match="extension of stranger: math:nothing cannot be loaded: .*; strange is left out"
    ):
        assert list(loaded_registry.load_all("networks of brdf")) == list(networks)[:-1]


def test_all_entries_that_ship_can_be_loaded() -> None:
    for table in registry().all_tables().values():
        for entry in table.values():
            for reference in module._references_in(entry):
                assert Lazy(reference).load() is not None


def test_no_two_entries_that_ship_have_one_name() -> None:
    """Entries of metapp itself are not checked when the registry is built, since every command would wait for it."""
    result = Registry()
    for register in (core.register, *(getattr(contents, name) for name in registry().extensions)):
        before = {title: dict(table) for title, table in result.all_tables().items()}
        register(result)
        module._check_entries(module.METAPP_PACKAGE, result, before)
    assert result.all_tables().keys() == registry().all_tables().keys()


# Entries of formats, exports and objects

FORMATS = {name: form for application in registry().applications.values() for name, form in application.formats.items()}
EXPORTS = {f"{kind}-{name}": form for (kind, name), form in registry().exports.items()}


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_modules_have_the_attributes_that_entries_name(name: str) -> None:
    form = FORMATS[name]
    module = form.load()
    assert callable(module.find)
    assert not form.inputs or callable(module.recognises)
    command = registry().commands.get(f"data {name}")
    if command and is_dataclass(converter := command.load()):
        options = list(converter().arguments())
        if hasattr(module, "conversion"):
            assert list(inspect.signature(module.conversion).parameters)[2:] == options
        else:
            assert module.UNITS
            assert set(options) <= set(inspect.signature(module.read_task).parameters)


@pytest.mark.parametrize("form", EXPORTS.values(), ids=EXPORTS)
def test_writers_take_an_asset_a_path_and_its_provenance(form: Export) -> None:
    parameters = inspect.signature(form.load()).parameters.values()
    names = [parameter.name for parameter in parameters if parameter.kind is not parameter.KEYWORD_ONLY]
    assert len(names) == 3
    assert names[2] == "provenance"


def test_assets_of_exports_and_pages_are_those_of_applications() -> None:
    kinds = {kind for application in registry().applications.values() for kind in application.assets}
    assert {kind for kind, _ in registry().exports} | registry().pages.keys() <= kinds


CONTRACTS = {
    "read_object": contracts.ReadObject,
    "merges": contracts.MergeInputs,
    "outputs": contracts.RenderFit,
    "pages": contracts.ViewFit,
    "assets": contracts.MakeAsset,
    "baselines": contracts.MakeBaselines,
    "facts": contracts.DescribeTensors,
    "file_exports": module.ExportFiles,
    "tables": module.MakeTable,
    "methods": module.FitMethod,
}


@pytest.mark.parametrize("field", CONTRACTS)
def test_functions_take_the_arguments_of_their_contracts(field: str) -> None:
    passed = inspect.signature(CONTRACTS[field].__call__).parameters.values()
    words = [parameter.name for parameter in passed if parameter.kind is parameter.POSITIONAL_ONLY][1:]  # after self
    assert words
    values = [getattr(owner, field, None) for owner in (registry(), *registry().applications.values())]
    tables = [table.values() for table in values if isinstance(table, dict)]
    entries = [*(entry for table in tables for entry in table), *(entry for entry in values if isinstance(entry, Lazy))]
    assert entries
    for entry in entries:
        inspect.signature(entry.load()).bind(*words)


def test_hooks_take_the_arguments_of_their_contracts() -> None:
    hooks = registry().hooks
    assert list(hooks) == list(module.HOOKS)
    inspect.signature(hooks["steps"].load()).bind("rule", "loss", "theta", 2, compiles=True)
    inspect.signature(hooks["scene"].load()).bind("scene")


@pytest.mark.parametrize("app", registry().applications)
def test_embedded_sets_fulfil_their_contract(app: str) -> None:
    synthetic = registry().applications[app].synthetic
    assert synthetic is not None
    drawn = synthetic.load()
    assert all(hasattr(drawn, name) for name in contracts.EmbeddedSet.__annotations__)
    assert list(drawn.COUNTS) == ["train", "test"]
    assert list(inspect.signature(drawn.synthetic_tasks).parameters)[:3] == ["split", "count", "seed"]


def test_registering_imports_nothing_but_texts() -> None:
    """Every command imports the registry and what it registers."""
    code = "import sys; from metapp.registry import registry; registry(); print(*sys.modules)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not {"torch", "numpy", "typer", "metapp.options", "metapp.apps.brdf.app"} & {*process.stdout.split()}

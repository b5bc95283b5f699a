"""How the code hangs together: who imports whom, who prints, and that nothing is unpickled unchecked."""

from __future__ import annotations

import ast
import configparser
import functools
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from metapp.door import Command, offers

ROOT = Path(__file__).parent.parent
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("metapp", "data_tools")
    for path in sorted((ROOT / package).rglob("*.py"))
}

UNPICKLES = "metapp.extensions.vgg.weights"
# fields of the first two are sizes of networks, those of the last two options of commands
MANY_MEMBERS = {"App", "ExemplarApp", "Request", "Evaluation"}


@functools.cache
def nodes(name: str) -> list[ast.AST]:
    """All nodes of a module's source; parsed where tests look at it, not by every process that collects them."""
    return list(ast.walk(ast.parse(FILES[name].read_text("utf-8"))))


@functools.cache
def imports(name: str) -> set[str]:
    """Modules of ours that a module imports, anywhere in it, as dotted names."""
    found: set[str] = set()
    for node in nodes(name):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            package = name if FILES[name].name == "__init__.py" else name.rpartition(".")[0]
            module = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            # `from package import module` names a module; `from module import function` does not.
            below = {f"{module}.{alias.name}" for alias in node.names}
            found |= (below & FILES.keys()) | ({module} if below - FILES.keys() else set())
    return {each for each in found if each.partition(".")[0] in ("metapp", "data_tools")}


def is_in(name: str, *places: str) -> bool:
    """Whether a module is one of these, or inside one of these packages."""
    return any(name == place or name.startswith(f"{place}.") for place in places)


@functools.cache
def calls(name: str) -> list[tuple[str, ast.Call]]:
    """All calls of a module, with what is called as it is written: `torch.load`."""
    return [(dotted(node.func), node) for node in nodes(name) if isinstance(node, ast.Call)]


def dotted(node: ast.expr) -> str:
    """A name as it is written; `ast.unparse` alone takes ten times as long."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return ast.unparse(node)


def modules(*places: str) -> list[str]:
    return [name for name in FILES if is_in(name, *places)]


def test_layers() -> None:
    """The contracts of setup.cfg hold: who imports whom, who knows a terminal."""
    done = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stdout


def test_modules_are_imported_by_name_at_the_door_alone() -> None:
    found = {name for name in FILES for called, _ in calls(name) if called.endswith("import_module")}
    assert found == {"metapp.door.finding"}


def test_paradigms_name_no_application() -> None:
    apps = {each.split(".")[2] for each in modules("metapp.apps") if each.count(".") == 2}
    for name in modules("metapp.paradigms"):
        assert not [each for each in imports(name) if is_in(each, "metapp.apps", "data_tools")], name
        texts = {node.value for node in nodes(name) if isinstance(node, ast.Constant)}
        assert not apps & {text for text in texts if isinstance(text, str)}, name


def test_only_the_command_line_prints_or_exits() -> None:
    talking = {"print", "exit", "quit", "sys.exit", "os._exit", "sys.stdout.write", "sys.stderr.write"}
    commands = {offer.command.partition(":")[0] for offer in offers(Command)}
    for name in (each for each in FILES if not is_in(each, "metapp.cli")):
        if name not in ("metapp.__main__", *commands):
            assert not [each for each in imports(name) if is_in(each, "metapp.cli")], name
        assert not [called for called, _ in calls(name) if called in talking], name


def test_nothing_is_unpickled() -> None:
    for name in FILES:
        forbidden = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
        forbidden -= {"pickle"} if name == UNPICKLES else set()
        for node in nodes(name):
            if isinstance(node, ast.Import | ast.ImportFrom):
                imported = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
                assert not forbidden & set(imported), name
        for called, node in calls(name):
            # numpy's own load refuses pickles unless told otherwise
            assert called != "torch.load" or name == UNPICKLES, name
            allowed = [each for each in node.keywords if each.arg == "allow_pickle"]
            assert not [each for each in allowed if ast.unparse(each.value) != "False"], name


def test_the_weights_of_others_are_unpickled_as_tensors_only() -> None:
    # Public weights are pickles; tests/extensions/vgg holds that their hashes come first, classes are refused.
    (unpickler,) = [
        node
        for node in nodes(UNPICKLES)
        if isinstance(node, ast.ClassDef) and "pickle.Unpickler" in map(ast.unparse, node.bases)
    ]
    assert "find_class" in [each.name for each in unpickler.body if isinstance(each, ast.FunctionDef)]
    used = {node.attr for node in nodes(UNPICKLES)
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "pickle"}  # fmt: skip
    assert used == {"Unpickler", "UnpicklingError"}
    imported = [node for node in nodes(UNPICKLES) if isinstance(node, ast.ImportFrom)]
    assert not [node for node in imported if node.module in ("pickle", "torch.serialization")]
    for called, node in calls(UNPICKLES):
        safe = [ast.unparse(each) for each in node.keywords if each.arg == "weights_only"] == ["weights_only=True"]
        assert called != "torch.load" or safe


@pytest.mark.parametrize("arguments", [[], ["data"], ["data", "merl"], ["meta", "brdf"]])
def test_help_answers_at_once(arguments: list[str]) -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'colour', 'matplotlib', 'numpy', 'scipy'} & sys.modules.keys())"
    done = subprocess.run(
        [sys.executable, "-c", lines, *arguments, "--help"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert done.stdout.splitlines()[-1] == "set()"


def members(node: ast.ClassDef) -> set[str]:
    """The public names that a class body defines, and those that its `__init__` sets."""
    names: set[str] = set()
    for statement in node.body:
        if isinstance(statement, ast.FunctionDef):
            names.add(statement.name)
            if statement.name == "__init__":
                names |= set(re.findall(r"self\.(\w+)[^=\n]*=[^=]", ast.unparse(statement)))
        elif isinstance(statement, ast.AnnAssign | ast.Assign):
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in names if not name.startswith("_")}


def inherited(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> set[str]:
    """The public names of a class's bases, of those that are ours."""
    bases = [classes[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes]
    return {name for base in bases if base is not node for name in members(base) | inherited(base, classes)}


def test_functions_and_classes_are_small() -> None:
    """Functions of at most 60 lines and 8 parameters, classes of at most 15 members of their own."""
    classes = {node.name: node for name in FILES for node in nodes(name) if isinstance(node, ast.ClassDef)}
    for node in (node for name in FILES for node in nodes(name)):
        if isinstance(node, ast.FunctionDef):
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            assert (node.end_lineno or 0) - node.lineno < 60, node.name
            assert len([each for each in arguments if each.arg not in ("self", "cls", "ctx")]) <= 8, node.name
        elif isinstance(node, ast.ClassDef):
            count = len(members(node) - inherited(node, classes))
            assert count <= 15 or node.name in MANY_MEMBERS, node.name


def test_no_circles_among_files() -> None:
    graph = {name: {each for each in imports(name) if each in FILES and each != name} for name in FILES}
    while leaves := {name for name, needed in graph.items() if not needed & graph.keys()}:
        graph = {name: needed for name, needed in graph.items() if name not in leaves}
    assert sorted(graph) == []


def test_every_extension_is_offered() -> None:
    """A folder that no entry point names would be installed and never found."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", "utf-8")
    points = setup["options.entry_points"]["metapp.extensions"].split("\n")
    offered = {point.partition(" = ")[2] for point in points}
    folders = {path.parent.name for path in (ROOT / "metapp" / "extensions").glob("*/__init__.py")}
    assert {f"metapp.extensions.{name}" for name in folders} <= offered


# what opens files by other means than metapp.storage.files: streams, folders, files of the package and the system
OPENS = ("metapp.storage.files", "metapp.storage.image_limits", "metapp.cli.streams")
OWN = ("resources.", "(resources.", "Path('/proc", "group /", "Path(each)", "source.read_text")


def test_files_are_opened_where_pipes_are_refused() -> None:
    """A FIFO among a user's files would be waited for without end."""
    for name in sorted(set(FILES) - set(OPENS)):
        for called, node in calls(name):
            reads = called.endswith((".read_bytes", ".read_text")) and not called.startswith(OWN)
            opens = called in ("open", "os.open", "io.open") or (called.endswith(".open") and mode_of(node) == "rb")
            if reads or opens:
                pytest.fail(f"{name}: {called}")


def mode_of(call: ast.Call) -> object:
    """The mode of `path.open(mode)`."""
    return call.args[0].value if call.args and isinstance(call.args[0], ast.Constant) else None

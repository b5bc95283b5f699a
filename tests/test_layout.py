"""The structure of the code: imports between layers, who prints, what is installed, and that nothing is unpickled."""

import ast
import configparser
import os
import re
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

from tests.recipe_apps import app_names

ROOT = Path(__file__).parent.parent
FILES = [path for package in ("metapp", "data_tools") for path in sorted((ROOT / package).rglob("*.py"))]
PRINTS = r"^ *(?:print|exit|quit|sys\.exit|os\._exit|sys\.std(?:out|err)\.write)\("
UNPICKLES = (
    r"^ *(?:import|from) (?:pickle|cPickle|dill|cloudpickle|joblib|shelve|marshal)\b"
    r"|torch\.load\(|allow_pickle=(?!False)"
)

# Commands: typer reads their signatures for --help, which imports no torch.
COMMANDS = r"metapp/cli/\w+\.py|metapp/extensions/\w+/(\w+/)?\w*commands?\.py"
# Files beside commands that import inside functions, each with its reason.
LATE_IMPORTS = {
    # the two modules that keep torch out of --help: options whose choice changes a recipe
    "metapp/apps/brdf/options.py": "networks that conserve energy need torch",
    # libraries that are not always installed
    "data_tools/readers/image_files.py": "pillow-heif",
    "data_tools/readers/nbrdf_files.py": "h5py",
    "metapp/extensions/capture/hand_photos.py": "OpenCV",
    # Mitsuba and Dr.Jit take a libLLVM once and for all when they are imported, and 0.2 s
    "data_tools/readers/brdf_objects.py": "Dr.Jit is there if a BSDF of Mitsuba is given",
    "metapp/apps/transport/scene_renderer.py": "integrators run after a scene is loaded",
    "metapp/extensions/guided/guided_picture.py": "a part of Mitsuba that needs a variant",
    "metapp/extensions/scene_files/trial_loading.py": "limits of memory, which Unix alone has, come before Mitsuba",
    "metapp/rendering/paths/path_space.py": "paths are traced after a scene is loaded",
    "metapp/rendering/second_scene/relighting.py": "the matrix is mostly in the cache",
    "metapp/rendering/variant.py": "the one place that chooses a libLLVM, then imports Mitsuba",
    # libraries that are slow to import, and modules that few runs need
    "metapp/appearance/colorimetry.py": "colour-science takes 1.1 s",
    "metapp/extensions/capture/ball/ball_reader.py": "SciPy's parts for balls take 0.7 s; maps need none of them",
    "metapp/storage/image_writers.py": "OpenImageIO takes 0.02 s; fits of BRDFs write no such picture",
}


def files_with(pattern: str) -> list[str]:
    """Our files in which a line matches."""
    found = (path for path in FILES if re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE))
    return [str(path.relative_to(ROOT)) for path in found]


def test_imports_keep_to_the_layers() -> None:
    """The contracts of setup.cfg hold: who imports whom, who knows a terminal."""
    process = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache"],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.returncode == 0, process.stdout


def test_no_circles_among_files() -> None:
    graph = grimp.build_graph("metapp", "data_tools", cache_dir=None)
    needed = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    while leaves := {name for name, others in needed.items() if not others & needed.keys()}:
        needed = {name: others for name, others in needed.items() if name not in leaves}
    assert sorted(needed) == []


def late_imports(path: Path) -> dict[str, int]:
    """The numbers of imports inside functions, by the names of these."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    found: dict[str, int] = {}

    def visit(node: ast.AST, function: str) -> None:
        for child in ast.iter_child_nodes(node):
            if function and isinstance(child, ast.Import | ast.ImportFrom):
                found[function] = found.get(function, 0) + 1
            inner = f"{function}.{getattr(child, 'name', 'lambda')}" if isinstance(child, functions) else function
            visit(child, inner)

    visit(ast.parse(path.read_text(encoding="utf-8")), "")
    return found


def test_imports_stand_at_the_top() -> None:
    """An import inside a function hides what a file needs: each file that has one is listed, with its reason."""
    late = {str(path.relative_to(ROOT)) for path in FILES if late_imports(path)}
    assert {file for file in late if not re.fullmatch(COMMANDS, file)} == LATE_IMPORTS.keys()


def test_a_command_imports_one_module() -> None:
    """The work of an extension's command stands in a module beside it, whose imports are at its top."""
    files = {str(path.relative_to(ROOT)): path for path in FILES if "extensions" in path.parts}
    commands = {file: late_imports(path) for file, path in files.items() if re.fullmatch(COMMANDS, file)}
    assert len(commands) >= 8
    assert not {file for file, late in commands.items() if max(late.values(), default=0) > 1}


def test_late_imports_are_found(tmp_path: Path) -> None:
    """Imports of functions, methods and inner functions count; those of a module, also under a condition, do not."""
    file = tmp_path / "module.py"
    file.write_text(
        "import a\nif a:\n    import b\nclass C:\n    def m(self):\n        import c\n        from d import e\n"
        "def f():\n    def g():\n        if a:\n            import h\n"
    )
    assert late_imports(file) == {".m": 2, ".f.g": 1}


def test_paradigms_name_no_application() -> None:
    named = files_with("|".join(f'"{name}"' for name in app_names()))
    assert not [file for file in named if file.startswith("metapp/paradigms")]


def test_only_the_command_line_prints_or_exits() -> None:
    assert not [file for file in files_with(PRINTS) if not file.startswith("metapp/cli/")]


def test_nothing_is_unpickled() -> None:
    """Public weights are the exception; tests/extensions/{measures,vgg} check that hashes are compared first."""
    assert files_with(UNPICKLES) == ["metapp/extensions/measures/perceptual.py", "metapp/extensions/vgg/weights.py"]


def test_every_extension_is_offered() -> None:
    """A folder that no entry point is called as would be installed and never found."""
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", "utf-8")
    points = setup["options.entry_points"]["metapp.extensions"].split("\n")
    offered = dict(point.split(" = ") for point in points if point)
    folders = {path.parent.name for path in (ROOT / "metapp" / "extensions").glob("*/__init__.py")}
    assert offered == {name: f"metapp.extensions.contents:{name}" for name in folders}


@pytest.mark.parametrize("arguments", [[], ["data"], ["data", "merl"], ["meta", "brdf"]])
def test_help_answers_at_once(arguments: list[str]) -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'colour', 'matplotlib', 'numpy', 'scipy'} & sys.modules.keys())"
    process = subprocess.run(
        [sys.executable, "-c", lines, *arguments, "--help"], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert process.stdout.splitlines()[-1] == "set()"

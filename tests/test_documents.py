"""README and docs: links lead somewhere; commands, targets and examples that they name exist."""

import ast
import doctest
import importlib.metadata
import re
import shlex
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from packaging.specifiers import SpecifierSet

from metapp.cli.command_tree import app as cli
from metapp.extensions import contents
from metapp.registry import registry
from tests.recipe_apps import app_names

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`]+)`")
COMMAND = typer.main.get_command(cli)  # it takes 40 ms to make
METAPP = re.compile(r"metapp [a-z]")
ANY_COMMAND = re.compile(r"metapp (?:data )?<")
PATH = re.compile(r"(?:metapp|data_tools|tests|benchmarks|tools|examples)/[\w./-]+$")
STANDS_FOR = re.compile(r"<[a-z]+>|\.\.\.|\b(?:NAME|APP|DIR)\b")  # what a reader puts in, such as brdf


def code_of(page: Path) -> list[str]:
    """Lines of code blocks and inline code, without comments."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    blocks = re.findall(r"^ *```\w*\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE)
    prose = re.sub(r"^ *```.*?^ *```", "", text, flags=re.DOTALL | re.MULTILINE)
    inline = [" ".join(code.split()) for code in CODE.findall(prose)]
    lines = [line for block in blocks for line in block.splitlines()] + inline
    return [re.sub(r"\s+#.*", "", line).strip() for line in lines]


def lines_of_code() -> Iterator[tuple[Path, str]]:
    """Every page with each of its lines of code."""
    for page in PAGES:
        for line in code_of(page):
            yield page, line


def links() -> Iterator[tuple[Path, str]]:
    """Every page with each of its links."""
    for page in PAGES:
        for link in LINK.findall(page.read_text(encoding="utf-8")):
            yield page, link


def anchor(heading: str) -> str:
    """A heading's anchor, as mkdocs makes it."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())


def anchors(page: Path) -> set[str]:
    return {anchor(line.lstrip("#")) for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("#")}


def test_links_lead_somewhere() -> None:
    for page, link in links():
        path, _, part = link.partition("#")
        if "://" not in link:
            target = page.parent / path if path else page
            assert target.exists(), (page, link)
            assert not part or part in anchors(target), (page, link)


def unknown_in(line: str, rules: Collection[str] = ()) -> str:
    """The first word of a `metapp` command that is no command, option or rule, nor among these rules; "" for none."""
    command: Any = COMMAND
    words = shlex.split(line)[1:]
    while words and hasattr(command, "get_command"):
        group, word = command, words.pop(0)
        word = "brdf" if word == "x" else word  # APP or NAME
        command = group.get_command(None, word)
        if command is None:
            return word
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    known |= {"--help", "-h"}
    for i, word in enumerate(words):
        if word.startswith("-") and word not in known:
            return word
        if word == "--rule" and words[i + 1] not in {*registry().rules, *rules}:
            return words[i + 1]
    return ""


def test_commands_and_options_in_pages_exist() -> None:
    for page, line in lines_of_code():
        if METAPP.match(line) and not ANY_COMMAND.match(line):
            declared = re.findall(r'registry.rules\["([\w-]+)"', page.read_text(encoding="utf-8"))
            assert unknown_in(STANDS_FOR.sub("x", line), declared) == "", (page, line)


def test_make_targets_in_pages_exist() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for page, line in lines_of_code():
        if line.startswith("make "):
            assert {word for word in line.split()[1:] if "=" not in word} <= targets, (page, line)


def test_files_named_in_pages_exist() -> None:
    for page, line in lines_of_code():
        if PATH.match(line):
            assert (ROOT / line).exists(), (page, line)


def test_python_in_pages_imports_what_exists() -> None:
    for page in PAGES:
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("metapp", "data_tools")):
                    module = importlib.import_module(node.module or "")
                    for alias in node.names:
                        assert hasattr(module, alias.name), (page, node.module, alias.name)


def test_every_picture_is_shown() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for picture in (ROOT / "docs").rglob("*.*"):
        if picture.suffix in (".jpg", ".png"):
            assert f"{picture.name})" in text, picture


def test_every_page_is_in_the_navigation() -> None:
    listed = set(re.findall(r": ([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE))
    pages = {str(page.relative_to(ROOT / "docs")) for page in PAGES if page.is_relative_to(ROOT / "docs")}
    assert listed == pages


def test_reference_pages_name_packages_that_exist() -> None:
    for page in (ROOT / "docs" / "api").glob("*.md"):
        for name in re.findall(r"^::: ([\w.]+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
            folder = ROOT.joinpath(*name.split("."))
            assert (folder / "__init__.py").is_file() or folder.with_suffix(".py").is_file(), name


def test_one_page_has_the_entries_of_all_extensions_that_ship() -> None:
    folders = {file.parent.name for file in (ROOT / "metapp" / "extensions").glob("*/README.md")}
    listed = {name for name in vars(contents) if name in folders and callable(getattr(contents, name))}
    assert folders == listed


def test_readme_is_one_screen_and_has_a_command_of_every_application() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 120
    for application in app_names():
        assert f"metapp meta {application} " in readme


def test_what_is_pinned_takes_the_python_of_debian_12() -> None:
    """All packages that are installed here accept Python 3.11.2, not merely a later 3.11."""
    pinned = {line.partition("==")[0].lower() for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()}
    for distribution in importlib.metadata.distributions():
        expected = distribution.metadata["Requires-Python"]
        if distribution.name.lower() in pinned and expected:
            assert SpecifierSet(expected).contains("3.11.2"), distribution.name


# Examples in docstrings are run


MODULES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for package in ("metapp", "data_tools")
    for path in sorted((ROOT / package).rglob("*.py"))
    if ">>> " in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings(name: str) -> None:
    result = doctest.testmod(importlib.import_module(name))
    assert result.attempted
    assert not result.failed

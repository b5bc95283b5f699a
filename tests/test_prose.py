"""Docstrings can be understood alone: none leans on another text by its first words."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("metapp", "data_tools", "tools", "benchmarks")
LEANING_BEGINNING = re.compile(r"(The same|That of|Those of|Of|As|None)\b")
LEANING_WORDS = re.compile(r"\b[Aa]s of `|\bthat of `|\bthose of `|[;,] as there\b")
FEWEST_WORDS = 3


def describe_leaning(text: str) -> str:
    """Return what is wrong with a docstring, or ""."""
    first = text.strip().splitlines()[0] if text.strip() else ""
    if LEANING_BEGINNING.match(first):
        return "begins by leaning on another text"
    if LEANING_WORDS.search(text):
        return "refers to another docstring for what it is"
    return "has fewer than three words" if len(first.split()) < FEWEST_WORDS else ""


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Return the mean luminance of maps [T, 3, H, W].", ""),
        ("The number of gradient steps: 0, since General only predicts.", ""),
        ("None of the tasks may be empty.", "begins"),
        ("The same for several photographs.", "begins"),
        ("Of BRDFs that are isotropic.", "begins"),
        ("Return parameters, as of `prepare`.", "refers"),
        ("One scene.", "fewer"),
    ],
)
def test_docstrings_that_lean_on_another_text_are_detected(text: str, says: str) -> None:
    assert says in describe_leaning(text)
    assert bool(says) == bool(describe_leaning(text))


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_can_be_understood_alone(folder: str) -> None:
    found = []
    for file in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text and (fault := describe_leaning(text)):
                    name = getattr(node, "name", "the module")
                    found.append(f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 1)} {name} {fault}: {text[:60]!r}")
    assert not found, "\n".join(found)

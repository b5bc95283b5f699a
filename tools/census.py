"""Size of the code: lines and `Any` by layer, long functions, many parameters, large classes.

    python tools/census.py            the counts and everything over a limit
    python tools/census.py metapp     of files under a folder

Lines are physical lines of `.py` files. Members of a class are the public names that it adds to those of its bases:
fields, methods, properties.
"""

from __future__ import annotations

import ast
import functools
import re
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
LINES, PARAMETERS, MEMBERS = 60, 8, 15
PRODUCTION = ("metapp", "data_tools")
FOLDERS = (*PRODUCTION, "tests", "benchmarks", "torture")


class Excess(NamedTuple):
    """Something over a limit."""

    place: str
    name: str
    what: str
    number: int


def layer_of(path: Path) -> str:
    """The layer that a file counts for: metapp/<folder>, data_tools/<folder>, tests, benchmarks or torture."""
    parts = path.relative_to(ROOT).parts
    return parts[0] if parts[0] not in PRODUCTION else "/".join(parts[:2]) if len(parts) > 2 else parts[0]


@functools.cache
def nodes(path: Path) -> list[ast.AST]:
    """All nodes of a file's source."""
    return list(ast.walk(ast.parse(path.read_text("utf-8"))))


def excesses(path: Path) -> Iterator[Excess]:
    """Everything over a limit in a file."""
    for node in nodes(path):
        place = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.FunctionDef):
            lines = (node.end_lineno or 0) - node.lineno + 1
            arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            parameters = len([argument for argument in arguments if argument.arg not in ("self", "cls", "ctx")])
            if lines > LINES:
                yield Excess(place, node.name, "lines", lines)
            if parameters > PARAMETERS:
                yield Excess(place, node.name, "parameters", parameters)
        if isinstance(node, ast.ClassDef) and (count := len(members(node) - inherited(node))) > MEMBERS:
            yield Excess(place, node.name, "members", count)


@functools.cache
def classes() -> dict[str, ast.ClassDef]:
    """The classes of production by name."""
    files = [path for folder in PRODUCTION for path in sorted((ROOT / folder).rglob("*.py"))]
    return {node.name: node for path in files for node in nodes(path) if isinstance(node, ast.ClassDef)}


def inherited(node: ast.ClassDef) -> set[str]:
    """The public names of a class's bases, of those that are ours."""
    bases = [classes()[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes()]
    return {name for base in bases if base is not node for name in members(base) | inherited(base)}


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


def main() -> None:
    """Print the counts."""
    below = ROOT / sys.argv[1] if len(sys.argv) > 1 else ROOT
    files = [
        path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")) if below in (path, *path.parents)
    ]
    lines: Counter[str] = Counter()
    loose: Counter[str] = Counter()
    for path in files:
        text = path.read_text("utf-8")
        lines[layer_of(path)] += text.count("\n")
        loose[layer_of(path)] += len(re.findall(r"\bAny\b", text))
    for layer, count in sorted(lines.items()):
        print(f"{count:7,d} lines {loose[layer]:4d} Any  {layer}")
    production = {
        layer: count
        for layer, count in lines.items()
        if layer.partition("/")[0] in PRODUCTION and layer != "data_tools/synthetic"
    }
    print(f"{sum(production.values()):7,d} lines {sum(loose[layer] for layer in production):4d} Any  production")
    found = [excess for path in files if path.relative_to(ROOT).parts[0] in PRODUCTION for excess in excesses(path)]
    for excess in sorted(found, key=lambda excess: (excess.what, -excess.number)):
        print(f"{excess.place}  {excess.name}: {excess.number} {excess.what}")


if __name__ == "__main__":
    main()

"""Measure how many small faults in the sources the tests notice: mutation score.

    python tools/mutants.py [N]        N faults a package (default 12); `make mutants` calls it

Faults are put into a copy of the repository, one at a time. They are chosen by a hash of their place, so that
unchanged code keeps its sample. Only the quick tests of the package run, up to the first failure. Faults that no test
notices are printed.
"""

from __future__ import annotations

import ast
import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from typing_extensions import override

TESTS_OF_PACKAGES = {
    "metapp/learning": ["tests/learning"],
    "metapp/paradigms": ["tests/paradigms"],
    "metapp/runs": ["tests/runs"],
    "data_tools/readers": ["tests/readers"],
}
TEST_TIMEOUT_SECONDS = 600  # for the tests of a package; a fault that makes them endless counts as noticed
OPERATOR_SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
}


def find_faults(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Return the nodes of function bodies that a fault can change, each with its enclosing names and its text."""

    def walk(node: ast.AST, names: str) -> Iterator[tuple[str, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            is_number = isinstance(child, ast.Constant) and type(child.value) in (bool, int, float)
            if isinstance(child, ast.FunctionDef):
                yield from walk(child, f"{names}.{child.name}")
            elif names and (is_number or type(child) in OPERATOR_SWAPS):
                yield f"{names}: {ast.unparse(node)}", child
            elif not (isinstance(child, ast.keyword) and child.arg == "strict"):
                yield from walk(child, names)

    return walk(tree, "")


def apply_fault(tree: ast.Module, fault: ast.AST) -> str:
    """Return the source with a fault: an operator is swapped, a number is replaced by the next, a truth is negated."""

    class Change(ast.NodeTransformer):
        @override
        def visit(self, node: ast.AST) -> ast.AST:
            if node is not fault:
                return self.generic_visit(node)
            if not isinstance(node, ast.Constant):
                return OPERATOR_SWAPS[type(node)]()
            value = node.value
            return ast.Constant(not value if isinstance(value, bool) else value + 1)  # type: ignore[operator]

    return ast.unparse(ast.fix_missing_locations(Change().visit(tree)))


def choose_faults(package: str, count: int) -> list[tuple[str, int, str]]:
    """Choose `count` of all faults of a package, by their hash.

    Returns:
        The file, the fault's number among all faults of the file, and its text.
    """
    faults = []
    for path in sorted(Path(package).rglob("*.py")):
        text_counts: dict[str, int] = {}
        for number, (text, _) in enumerate(find_faults(ast.parse(path.read_text()))):
            text_counts[text] = text_counts.get(text, 0) + 1
            digest = hashlib.sha256(f"{path.name}{text}{text_counts[text]}".encode()).hexdigest()
            faults.append((digest, (str(path), number, text)))
    return [fault for _, fault in sorted(faults)[:count]]


def is_fault_noticed(folder: Path, tests: list[str]) -> bool:
    """Return whether a test fails in the copy of the repository."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not long and not slow"]
    try:
        run = subprocess.run([*command, *tests], cwd=folder, capture_output=True, timeout=TEST_TIMEOUT_SECONDS)
        return run.returncode != 0
    except subprocess.TimeoutExpired:
        return True


def main(count: int) -> None:
    """Print how many of `count` faults in each package the tests notice."""
    with tempfile.TemporaryDirectory() as name:
        folder, noticed_total = Path(name), 0
        files = subprocess.run(["git", "ls-files", "-z"], capture_output=True, check=True, text=True).stdout
        subprocess.run(["cp", "--parents", "-t", name, *files.strip("\0").split("\0")], check=True)
        for package, tests in TESTS_OF_PACKAGES.items():
            if is_fault_noticed(folder, tests):
                sys.exit(f"{package}: its tests fail without any fault; mend them first.")
            faults, noticed_count = choose_faults(package, count), 0
            for path, number, text in faults:
                source = (folder / path).read_text()
                tree = ast.parse(source)
                (folder / path).write_text(apply_fault(tree, list(find_faults(tree))[number][1]))
                if is_fault_noticed(folder, tests):
                    noticed_count += 1
                else:
                    print(f"  not noticed: {path}{text.replace(chr(10), ' ')[:150]} (fault {number})", flush=True)
                (folder / path).write_text(source)
            noticed_total += noticed_count
            print(f"{package}: {noticed_count} of {len(faults)} faults noticed", flush=True)
        print(f"all: {noticed_total} of {count * len(TESTS_OF_PACKAGES)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)

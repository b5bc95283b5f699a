"""Mutation score of the tests: small faults are put into a copy of the sources, one at a time; tests should fail.

    python tools/mutants.py [N]        N faults a package (default 12); `make mutants` calls it

Faults are chosen by a hash of their place, so that code which has not changed keeps its sample. Only the tests of the
package run, quick ones, up to the first failure. Faults that no test notices are printed.
"""

from __future__ import annotations

import ast
import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

TESTS_OF_PACKAGES = {
    "metapp/learning": ["tests/learning"],
    "metapp/paradigms": ["tests/paradigms"],
    "metapp/runs": ["tests/runs"],
    "data_tools/readers": ["tests/readers"],
}
TEST_TIMEOUT_SECONDS = 600  # for the tests of a package; a fault that makes them endless is noticed
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
    """Nodes of function bodies that a fault can change, each with its enclosing names and its text."""

    def walk(node: ast.AST, names: str) -> Iterator[tuple[str, ast.AST]]:
        for child in ast.iter_child_nodes(node):
            number = isinstance(child, ast.Constant) and type(child.value) in (bool, int, float)
            if isinstance(child, ast.FunctionDef):
                yield from walk(child, f"{names}.{child.name}")
            elif names and (number or type(child) in OPERATOR_SWAPS):
                yield f"{names}: {ast.unparse(node)}", child
            elif not (isinstance(child, ast.keyword) and child.arg == "strict"):
                yield from walk(child, names)

    return walk(tree, "")


def apply_fault(tree: ast.Module, fault: ast.AST) -> str:
    """The source with the fault: an operator replaced by its counterpart, a number by the next, a truth negated."""

    class Change(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST:
            if node is not fault:
                return self.generic_visit(node)
            if not isinstance(node, ast.Constant):
                return OPERATOR_SWAPS[type(node)]()
            value = node.value
            return ast.Constant(not value if isinstance(value, bool) else value + 1)  # type: ignore[operator]

    return ast.unparse(ast.fix_missing_locations(Change().visit(tree)))


def choose_faults(package: str, count: int) -> list[tuple[str, int, str]]:
    """File, number of the fault in it, and its text: `count` of all faults of a package, by their hash."""
    found = []
    for path in sorted(Path(package).rglob("*.py")):
        counts: dict[str, int] = {}
        for number, (text, _) in enumerate(find_faults(ast.parse(path.read_text()))):
            counts[text] = counts.get(text, 0) + 1
            digest = hashlib.sha256(f"{path.name}{text}{counts[text]}".encode()).hexdigest()
            found.append((digest, (str(path), number, text)))
    return [fault for _, fault in sorted(found)[:count]]


def is_fault_noticed(folder: Path, tests: list[str]) -> bool:
    """Whether a test fails in the copy of the repository in `folder`."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not long and not slow"]
    try:
        return (
            subprocess.run([*command, *tests], cwd=folder, capture_output=True, timeout=TEST_TIMEOUT_SECONDS).returncode
            != 0
        )
    except subprocess.TimeoutExpired:
        return True


def main(count: int) -> None:
    """Score of each package, printed, for `count` faults in each."""
    with tempfile.TemporaryDirectory() as name:
        folder, total = Path(name), 0
        files = subprocess.run(["git", "ls-files", "-z"], capture_output=True, check=True, text=True).stdout
        subprocess.run(["cp", "--parents", "-t", name, *files.strip("\0").split("\0")], check=True)
        for package, tests in TESTS_OF_PACKAGES.items():
            if is_fault_noticed(folder, tests):
                sys.exit(f"{package}: its tests fail without any fault; mend them first.")
            chosen, killed = choose_faults(package, count), 0
            for path, number, text in chosen:
                source = (folder / path).read_text()
                tree = ast.parse(source)
                (folder / path).write_text(apply_fault(tree, list(find_faults(tree))[number][1]))
                if is_fault_noticed(folder, tests):
                    killed += 1
                else:
                    print(f"  not noticed: {path}{text.replace(chr(10), ' ')[:150]} (fault {number})", flush=True)
                (folder / path).write_text(source)
            total += killed
            print(f"{package}: {killed} of {len(chosen)} faults noticed", flush=True)
        print(f"all: {total} of {count * len(TESTS_OF_PACKAGES)}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)

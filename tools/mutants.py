"""Mutation testing: change one thing in a source file, run the tests that belong to it, and list what no test caught.

    python tools/mutants.py                         a sample of 200 of all files below
    python tools/mutants.py --count 0 adjoint       all mutants of the files whose path contains "adjoint"
    python tools/mutants.py --minutes 10            as many as 10 minutes allow; each prefix of a sample is a sample

Every mutant runs in a forked process that already has torch, so that one costs what its tests cost.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import os
import random
import resource
import signal
import sys
import time
from collections.abc import Iterator
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "metapp/extensions/native/in_c.py": ["in_c"],
    "metapp/extensions/native/packing.py": ["in_c"],
    "metapp/learning/adjoint.py": ["adjoint"],
    "metapp/learning/app.py": ["learning", "brdf"],
    "metapp/learning/learn.py": ["learning", "adjoint"],
    "metapp/learning/task.py": ["task", "learning"],
    "metapp/learning/rules": ["parts", "compositions", "descent", "learned_descent", "solve"],
    "metapp/appearance/colour.py": ["colour", "photos"],
    "metapp/appearance/features.py": ["features"],
    "metapp/appearance/flash.py": ["flash"],
    "metapp/appearance/geometry.py": ["geometry", "merl", "reflection", "flash"],
    "metapp/appearance/latlong.py": ["latlong"],
    "metapp/appearance/metrics.py": ["colour"],
    "metapp/appearance/photograph.py": ["photograph"],
    "metapp/appearance/reflection.py": ["reflection"],
    "data_tools/synthetic/interfaces.py": ["reflection"],
    "metapp/appearance/sphere.py": ["sphere"],
    "metapp/appearance/surface.py": ["planes"],
    "metapp/extensions/assets/planes.py": ["planes"],
    "metapp/extensions/guided/cache.py": ["guide_prior", "guide_cache"],
    "metapp/extensions/guided/histogram.py": ["guide_prior"],
    "metapp/rendering/scenes/plugins.py": ["scene_attacks", "scene_files", "scene_limits"],
    "metapp/rendering/scenes/rules.py": ["scene_attacks", "scene_limits"],
    "metapp/extensions/scene_files/places.py": ["scene_attacks", "scene_places"],
    "metapp/extensions/baselines/brdf.py": ["brdf_baselines", "brdf_fits"],
    "metapp/extensions/baselines/components.py": ["brdf_baselines", "brdf_fits"],
    "metapp/extensions/baselines/lobes.py": ["brdf_baselines", "brdf_fits"],
    "metapp/extensions/baselines/transport.py": ["histogram"],
    "metapp/runs/outputs/statistics.py": ["statistics"],
}
COMPARES = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And}
SLACK_SECONDS = 20  # of CPU time beyond three times what the tests take without a change


class Mutant(NamedTuple):
    """A source file with one change.

    Attributes:
        path: of the file, relative to the repository.
        line: of the change.
        change: in words, "< becomes <=".
        source: of the whole mutated file.
    """

    path: str
    line: int
    change: str
    source: str


def changes(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield every mutation of one node, with its description."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in COMPARES:
            yield _replaced(node, operator, COMPARES[type(operator)](), "ops", [COMPARES[type(operator)]()])
        case ast.BinOp(op=operator) | ast.AugAssign(op=operator) | ast.BoolOp(op=operator) if (
            type(operator) in OPERATORS
        ):
            instead = OPERATORS[type(operator)]()
            yield _replaced(node, operator, instead, "op", instead)
        case ast.Constant(value=bool(value)):
            yield f"{value} becomes {not value}", ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)):
            other = value + 1 if isinstance(value, int) else 2 * value or 1.0
            yield f"{value} becomes {other}", ast.Constant(other)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield f"{ast.unparse(node)} becomes {ast.unparse(operand)}", operand
    if isinstance(node, ast.AugAssign | ast.Raise) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield f"{ast.unparse(node)[:60]} removed", ast.Pass()


def _replaced(node: ast.AST, before: ast.AST, after: ast.AST, field: str, value: object) -> tuple[str, ast.AST]:
    other = copy.copy(node)
    setattr(other, field, value)
    return f"{type(before).__name__} becomes {type(after).__name__}", other


def slots(tree: ast.AST) -> Iterator[tuple[ast.AST, str, int | None]]:
    """Yield the places of all nodes but annotations: the parent, its field, the index in a list."""
    for field, value in ast.iter_fields(tree):
        if field in ("annotation", "returns"):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST):
                yield tree, field, index
                yield from slots(child)


def mutants_of(path: str) -> list[Mutant]:
    """All mutants of a file."""
    tree, made = ast.parse((ROOT / path).read_text()), []
    for parent, field, index in list(slots(tree)):
        node = getattr(parent, field) if index is None else getattr(parent, field)[index]
        for change, other in changes(node):
            _put(parent, field, index, ast.copy_location(other, node))
            source = ast.unparse(ast.fix_missing_locations(tree))
            made.append(Mutant(path, getattr(node, "lineno", 0), change, source))
        _put(parent, field, index, node)
    return made


def _put(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def run_tests(files: list[str], mutant: Mutant | None, limit: int) -> tuple[bool, float]:
    """Run tests in a forked process, with the mutant in place of its file.

    Returns:
        Whether all tests passed within `limit` seconds of CPU time, and the CPU seconds.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    if (child := os.fork()) == 0:
        os._exit(_in_child(files, mutant, limit))
    _, status = os.waitpid(child, 0)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return status == 0, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _in_child(files: list[str], mutant: Mutant | None, limit: int) -> int:
    import pytest

    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
    signal.alarm(20 * limit)  # a process that waits takes no CPU time
    os.setpgrp()
    if mutant is not None:
        _import_instead(mutant)
    with open(os.devnull, "w") as null, contextlib.redirect_stdout(null), contextlib.redirect_stderr(null):
        scratch = f"/tmp/mutant-{os.getpid()}"
        options = ["-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:faulthandler"]
        code = int(pytest.main([*options, "--basetemp", scratch, *files]))
    os.system(f"rm -rf {scratch}")
    return code


def _import_instead(mutant: Mutant) -> None:
    file, original = str(ROOT / mutant.path), SourceFileLoader.get_code

    def get_code(self: SourceFileLoader, name: str):  # type: ignore[no-untyped-def]
        return compile(mutant.source, file, "exec") if self.path == file else original(self, name)

    SourceFileLoader.get_code = get_code  # type: ignore[assignment, method-assign]


def sources(words: list[str]) -> dict[str, list[str]]:
    """The test files of each source file whose path contains one of the words; of all without words."""
    found = {}
    for place, names in TESTS.items():
        files = [ROOT / place] if place.endswith(".py") else sorted((ROOT / place).rglob("*.py"))
        tests = [str(next((ROOT / "tests").rglob(f"test_{name}.py"))) for name in names]
        for path in (str(file.relative_to(ROOT)) for file in files):
            if not words or any(word in path for word in words):
                found[path] = tests
    return found


def main() -> None:
    """Print each survivor as it is found, and the share that was caught of each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="parts of the paths of files to mutate; all without any")
    parser.add_argument("--count", type=int, default=200, help="size of the sample; 0 takes all mutants")
    parser.add_argument("--minutes", type=float, default=60, help="after which no further mutant is tried")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    options = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    os.environ["OMP_NUM_THREADS"] = "1"
    import torch  # noqa: F401  (before the forks)

    tests = sources(options.words)
    every = [mutant for path in tests for mutant in mutants_of(path)]
    count = min(options.count or len(every), len(every))
    print(f"{count} of {len(every)} mutants, seed {options.seed}", flush=True)
    caught: dict[str, list[bool]] = {}
    began, limits = time.perf_counter(), {}
    for mutant in random.Random(options.seed).sample(every, count):
        if time.perf_counter() - began > 60 * options.minutes:
            break
        if mutant.path not in limits:
            passed, seconds = run_tests(tests[mutant.path], None, 3600)
            if not passed:
                raise SystemExit(f"{mutant.path}: its tests fail without a change; mend these first.")
            limits[mutant.path] = int(3 * seconds + SLACK_SECONDS)
        survived, _ = run_tests(tests[mutant.path], mutant, limits[mutant.path])
        caught.setdefault(mutant.path, []).append(not survived)
        if survived:
            print(f"survived  {mutant.path}:{mutant.line}  {mutant.change}", flush=True)
    for path, each in sorted(caught.items()):
        print(f"{sum(each):4d} of {len(each):4d} caught  {path}")
    total = [value for each in caught.values() for value in each]
    print(f"{sum(total):4d} of {len(total):4d} caught, {time.perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()

"""Lock files and tools/setup.sh: all that is installed is pinned, and checked by SHA-256."""

import configparser
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parent.parent
UNLOCKED = {"jax", "jaxlib", "optree", "torchopt"}  # what `make bench` compares with, if somebody installs it
# a Python that installs nothing, but notes what pip is asked for; pip fails where its arguments hold $FAILS
PYTHON = """#!/bin/bash
case "$*" in
  *"-m venv"*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && printf '#!/bin/bash\\n' >"$3/bin/metapp" &&
    chmod +x "$3/bin/metapp" ;;
  *"-m pip"*) echo "$*" >>"$CALLS"
    if [[ -n "$FAILS" && "$*" = *$FAILS* ]]; then echo "$MESSAGE" >&2; exit 1; fi ;;
  *"import sys, torch"*) exit 1 ;;
  *sys.argv*) echo numpy ;;
esac
"""


def locked_versions(name: str) -> dict[str, set[Version]]:
    """Versions of a lock file by package: several, where later Pythons have a later one. Each has a SHA-256."""
    versions: dict[str, set[Version]] = {}
    for entry in re.split(r"\n(?=\S)", (ROOT / "locks" / f"{name}.txt").read_text("utf-8").strip()):
        requirement, *hashes = entry.split(" \\\n")
        assert hashes, entry
        assert all(re.fullmatch(r" +--hash=sha256:[0-9a-f]{64}", line) for line in hashes), entry
        package, version = requirement.split(" ;")[0].split("==")
        versions.setdefault(canonicalize_name(package), set()).add(Version(version))
    return versions


def constrained_versions() -> dict[str, str]:
    pins = [line.split("==") for line in (ROOT / "constraints.txt").read_text("utf-8").splitlines()]
    return {canonicalize_name(package): version for package, version in pins}


def required_packages(*extras: str) -> set[str]:
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg")
    lines = [setup["options.extras_require"][extra] for extra in extras] or [setup["options"]["install_requires"]]
    return {canonicalize_name(Requirement(line).name) for line in "\n".join(lines).split()}


@pytest.mark.parametrize("name", ["packages", "torch", "torch-cpu", "docs", "cluster"])
def test_locked_versions_are_those_of_the_constraints(name: str) -> None:
    for package, versions in locked_versions(name).items():
        if package in constrained_versions():
            assert {version.public for version in versions} == {constrained_versions()[package]}, package


def test_all_packages_that_setup_installs_are_locked() -> None:
    packages, torch = locked_versions("packages"), locked_versions("torch")
    extras = {name: locked_versions(name) for name in ("docs", "cluster")}
    assert required_packages() | required_packages("dev") | {"pip", "setuptools"} <= packages.keys() | {"torch"}
    assert all(required_packages(name) <= extra.keys() for name, extra in extras.items())
    assert "torch" in torch
    assert locked_versions("torch-cpu") == {"torch": {Version(f"{constrained_versions()['torch']}+cpu")}}
    assert (
        constrained_versions().keys()
        - packages.keys()
        - torch.keys()
        - {name for extra in extras.values() for name in extra}
        == UNLOCKED
    )
    for extra in extras.values():  # beside the others in one environment
        assert all(extra[package] == packages[package] for package in extra.keys() & packages.keys())


def set_up(
    folder: Path, fails: str = "", message: str = "", **variables: str
) -> tuple[list[str], subprocess.CompletedProcess[str]]:
    """Run setup.sh with a Python that installs nothing: the calls of pip, and how the script ended."""
    calls, python = folder / "calls", folder / "python"
    calls.touch()
    python.write_text(PYTHON)
    python.chmod(0o755)
    environment = {key: value for key, value in os.environ.items() if key not in ("HASHES", "TORCH_INDEX")}
    process = subprocess.run(
        ["bash", "tools/setup.sh", str(python), str(folder / "venv")],
        cwd=ROOT,
        env=environment | {"CALLS": str(calls), "FAILS": fails, "MESSAGE": message} | variables,
        capture_output=True,
        text=True,
    )
    return calls.read_text().splitlines(), process


@pytest.fixture(autouse=True)
def _no_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("nvidia-smi"):
        pytest.skip("the machine has an NVIDIA driver, which setup.sh would see")


def test_setup_installs_by_hash_and_builds_the_project_alone(tmp_path: Path) -> None:
    (torch, packages, project), done = set_up(tmp_path)
    assert done.returncode == 0, done.stderr
    for call, name in ((torch, "torch-cpu"), (packages, "packages")):
        assert f"install --require-hashes --no-deps --only-binary :all: -r locks/{name}.txt" in call
    assert project.endswith("install --no-index --no-deps --no-build-isolation -e .")


def test_setup_looks_for_the_cpu_build_in_the_default_index_then_takes_pypis(tmp_path: Path) -> None:
    calls, done = set_up(tmp_path, "torch-cpu.txt", "No matching distribution", TORCH_INDEX="https://example.org")
    assert done.returncode == 0, done.stderr
    assert re.findall(r"locks/(\S+)\.txt", "\n".join(calls)) == ["torch-cpu", "torch-cpu", "torch", "packages"]
    assert ["--index-url https://example.org" in call for call in calls[:3]] == [True, False, False]


@pytest.mark.parametrize("name", ["torch-cpu", "packages"])
def test_setup_stops_where_a_hash_differs(tmp_path: Path, name: str) -> None:
    calls, done = set_up(tmp_path, f"{name}.txt", "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES: numpy")
    assert done.returncode == 1
    assert f"{name}.txt" in calls[-1]
    pip, line = done.stderr.splitlines()
    assert "numpy" in pip
    assert line.startswith("setup: ")
    assert f"locks/{name}.txt" in line
    assert "HASHES=off make setup" in line


def test_setup_without_hashes_takes_the_constraints(tmp_path: Path) -> None:
    calls, done = set_up(tmp_path, HASHES="off")
    assert done.returncode == 0, done.stderr
    assert not any("--require-hashes" in call for call in calls)
    assert ["-c constraints.txt" in call for call in calls] == [True, True, False]

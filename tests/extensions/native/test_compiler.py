"""Compiled C sources in the cache folder: once for all processes, in a folder of the user alone."""

import stat
from pathlib import Path

import pytest

from metapp.extensions.native import compiler as module
from metapp.extensions.native.compiler import find_compiler, load_library
from metapp.storage.cache_folders import cache_folder
from tests import forks

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="needs a C compiler: apt-get install gcc libc6-dev")


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """These look at what is kept."""
    monkeypatch.setattr(module, "cache_folder", cache_folder)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A small source: those of the network take seconds to compile."""
    path = tmp_path / "seven.c"
    path.write_text("int seven(void) { return 7; }\n")
    return path


@needs_compiler
def test_a_library_is_kept_in_a_folder_of_the_user_alone(cache: Path, source: Path) -> None:
    kept = cache / "native"
    kept.mkdir(mode=0o755)
    functions = load_library.__wrapped__(source, "seven")
    assert functions is not None
    assert functions.seven() == 7
    assert stat.S_IMODE(kept.stat().st_mode) == 0o700
    assert [path.suffix for path in kept.iterdir()] == [".so"]


def codes(source: Path, cache: Path, count: int = 1, *, found: bool = True, **environment: str) -> list[int | None]:
    """Exit codes of processes that load the functions of a source; they fail where these are not as `found` says."""
    more = {"METAPP_CACHE": str(cache), **environment}
    started = [
        forks.start_in_fork(
            forks.load_compiled_source, source, found, output_folder=cache / "said", extra_environment=more
        )
        for _ in range(count)
    ]
    return [program.wait_for_output(120)[0] for program in started]


@needs_compiler
def test_compiled_once_by_many_processes(source: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert codes(source, cache, 3) == [0, 0, 0]
    (library,) = (cache / "native").glob("*.so")
    result = library.stat().st_mtime_ns
    assert codes(source, cache, CC="/nonexistent/cc") == [0]  # nothing is compiled again
    assert library.stat().st_mtime_ns == result


@pytest.mark.parametrize("command", ["/nonexistent/cc", "false"])
def test_without_a_compiler_or_with_a_broken_one(command: str, source: Path, tmp_path: Path) -> None:
    assert codes(source, tmp_path / "cache", found=False, CC=command) == [0]
    assert not list((tmp_path / "cache").rglob("*.so"))

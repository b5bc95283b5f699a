"""Which libLLVM Mitsuba gets, and that none that aborts the process is among them."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from metapp.rendering import variant as mitsuba_variant
from metapp.rendering.variant import (
    KERNELS_VARIABLE,
    LLVM_VARIABLE,
    OLDEST_LLVM,
    choose_kernel_folder,
    find_llvm,
    llvm_version,
)
from tests.needs_mitsuba import needs_mitsuba

SYSTEM = sorted(
    path for folder in mitsuba_variant._SYSTEM_FOLDERS for path in Path("/").glob(f"{folder[1:]}/libLLVM[-.]*")
)


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The library folder of an environment, where nothing else is in reach."""
    monkeypatch.delenv(LLVM_VARIABLE, raising=False)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(mitsuba_variant, "_SYSTEM_FOLDERS", ())
    (tmp_path / "lib" / "llvm").mkdir(parents=True)
    return tmp_path / "lib"


def make(path: Path) -> Path:
    path.touch()
    return path


def test_names_and_links_tell_the_version(tmp_path: Path) -> None:
    names = {"libLLVM.so.19.1": 19, "libLLVM-15.so.1": 15, "libLLVM-14.0.6.so.1": 14, "libLLVM-20.so": 20}
    assert {name: llvm_version(make(tmp_path / name)) for name in names} == names
    link = tmp_path / "linked.so"
    link.symlink_to(tmp_path / "libLLVM-15.so.1")
    assert llvm_version(link) == 15
    assert llvm_version(tmp_path / "libLLVM.so.22") is None  # not there
    assert llvm_version(make(tmp_path / "libLLVM.so")) is None  # no library


def test_a_library_without_a_version_in_its_name_is_asked(tmp_path: Path) -> None:
    try:
        found_library = find_llvm()
    except ValueError as error:
        pytest.skip(str(error))
    copy = tmp_path / "libLLVM.so"
    try:
        os.link(found_library.resolve(), copy)
    except OSError:
        pytest.skip(f"{tmp_path} is on another disk than {found_library}")
    assert llvm_version(copy) == llvm_version(found_library)


def test_the_users_choice_comes_first_then_the_environments(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    environment_library = make(environment / "llvm" / "libLLVM.so.19.1")
    make(environment / "libLLVM-20.so")
    assert find_llvm() == environment_library
    chosen = make(environment.parent / "libLLVM-22.so")
    monkeypatch.setenv(LLVM_VARIABLE, str(chosen))
    assert find_llvm() == chosen


def test_old_libraries_are_passed_over_with_a_remedy(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match=r"found none, expected 19 or newer.*apt-get install libllvm19"):
        find_llvm()
    make(environment / "libLLVM-15.so.1")
    monkeypatch.setenv(LLVM_VARIABLE, str(make(environment / "libLLVM-18.so")))
    with pytest.raises(ValueError, match=r"version 15.*expected 19 or newer.*apt-get install libllvm19") as caught:
        find_llvm()
    assert "\n" not in str(caught.value)
    fit = make(environment / "libLLVM.so.19.1")
    assert find_llvm() == fit


def output_of_process(lines: str, *arguments: str, **environment: str) -> str:
    """What another process prints."""
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", lines, *arguments]
    process = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=root, env={**os.environ, **environment}, timeout=120
    )
    return process.stdout.strip()


@pytest.mark.long
def test_a_mitsuba_with_an_old_library_is_refused() -> None:
    old = [path for path in SYSTEM if 15 <= (llvm_version(path) or 0) < OLDEST_LLVM]
    try:
        fit = find_llvm()
    except ValueError as error:
        pytest.skip(str(error))
    if not old:
        pytest.skip("no old libLLVM here")
    lines = "import mitsuba\nfrom metapp.rendering.variant import *\nimport os\ndel os.environ[LLVM_VARIABLE]\n"
    lines += f"os.environ[LLVM_VARIABLE] = {str(fit)!r}\n"
    lines += "try:\n    load_mitsuba()\nexcept ValueError as error:\n    print(error)"
    assert "imported before with libLLVM" in output_of_process(lines, **{LLVM_VARIABLE: str(old[0])})


@pytest.mark.long
@needs_mitsuba
def test_exr_files_work_with_one_thread_of_torch(tmp_path: Path) -> None:
    """Mitsuba waits for a thread of Dr.Jit's pool, which has one less than it is told."""
    lines = "import sys, numpy, torch\nfrom metapp.rendering.variant import load_mitsuba\ntorch.set_num_threads(1)\n"
    lines += "mi = load_mitsuba()\nmi.Bitmap(numpy.ones((64, 32, 3), 'float32')).write(sys.argv[1])\n"
    assert output_of_process(lines + "print(mi.Bitmap(sys.argv[1]).size())", str(tmp_path / "a.exr")) == "[32, 64]"


def test_kernels_are_kept_in_the_cache_where_there_is_no_home_folder(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HOME", str(tmp_path / "file"))
    monkeypatch.setenv(KERNELS_VARIABLE, "")
    choose_kernel_folder()
    assert os.environ[KERNELS_VARIABLE] == str(cache / "drjit")


def test_kernels_that_other_users_can_write_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ".drjit"
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(KERNELS_VARIABLE, "")
    choose_kernel_folder()
    assert os.environ[KERNELS_VARIABLE] == str(folder)
    shared = tmp_path / "shared"
    shared.mkdir()
    (shared / "kernel.bin").touch()
    shared.chmod(0o777)
    monkeypatch.setenv(KERNELS_VARIABLE, str(shared))
    with pytest.warns(UserWarning, match=rf"shared: .* open to others, .* {KERNELS_VARIABLE} name another place\.$"):
        choose_kernel_folder()
    assert not any(Path(os.environ[KERNELS_VARIABLE]).glob("*.bin"))
    assert stat.S_IMODE(Path(os.environ[KERNELS_VARIABLE]).stat().st_mode) == 0o700

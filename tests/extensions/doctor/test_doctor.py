"""`metapp doctor`: it lists what is installed and what is missing."""

from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import pytest

from metapp.appearance.features import vgg_weights_path
from metapp.extensions.doctor import installation
from tests.cli.messages import says


def test_doctor_lists_what_is_installed(metapp: Callable, cache: Path) -> None:
    document = metapp("doctor", "--json").json_document
    assert document["versions"]["torch"] == metadata.version("torch")
    assert document["cache"] == str(cache)
    assert document["checkpoints"]["texture full"] == "general, meta-encoder, quickft"
    assert "general-photo" in document["checkpoints"]["svbrdf_nonstationary pretrained"]
    assert "gauss-newton-photo" in document["checkpoints"]["svbrdf_nonstationary several"]
    assert "brdf full" not in document["checkpoints"]  # of the quick recipe's size, in its folder
    lines = metapp("doctor").out.splitlines()
    assert lines[0].split()[:2] == ["versions", "metapp"]
    (line,) = [line for line in lines if "texture full" in line]
    assert line.split("texture full")[1].strip() == "general, meta-encoder, quickft"
    items = [*document["versions"], *document["data"], *document["checkpoints"], *document["extras"]]
    for item in items:  # a line each, in columns
        assert any(line[12:].startswith(f"{item} ") for line in lines), item
    others = len(document) - 4
    assert len(lines) == len(items) + others


def test_doctor_reports_a_missing_compiler(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(Path.cwd()))
    for _ in ("missing", "broken"):
        assert metapp("doctor", "--json").json_document["compiler"].startswith("none that works")
        Path("g++").write_text("#!/bin/sh\nexit 1\n")
        Path("g++").chmod(0o755)


def test_doctor_fails_where_commands_would(metapp: Callable, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation, "find_llvm", lambda: "libLLVM.so")
    result = metapp("doctor")  # the cache is empty, as of a fresh installation
    assert result.code == 0
    assert result.out.splitlines()[-1] == "fails       nothing"
    assert says(result.out, "VGG", "not fetched", "texture", "metapp data vgg")
    vgg_weights_path().write_bytes(b"damaged")
    result = metapp("doctor", "--json")
    assert (result.code, result.json_document["fails"]) == (1, ["VGG"])
    assert says(result.json_document["VGG"], "damaged", "metapp data vgg")
    (cache / "file").write_text("")
    monkeypatch.setenv("METAPP_CACHE", str(cache / "file"))
    result = metapp("doctor", "--json")
    assert (result.code, result.json_document["fails"]) == (1, ["cache"])
    assert "set METAPP_CACHE to one" in result.json_document["cache"]


def test_doctor_lists_missing_extras(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installation.util, "find_spec", lambda name: None if name == "cv2" else name)
    document = metapp("doctor", "--json").json_document
    assert document["extras"]["capture"].startswith("missing, for metapp data rectify")
    assert document["extras"]["heic"] == "installed"
    assert "extras" not in document["fails"]

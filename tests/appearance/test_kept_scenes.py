"""Scenes of spheres in the cache: the same as made anew, and made anew where what is there cannot be taken."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from metapp.appearance import sphere
from metapp.appearance.sphere import SphereScene, sphere_scene
from metapp.storage import kept

SIZE = 8


def small() -> SphereScene:
    return sphere_scene(SIZE)


def never() -> SphereScene:
    pytest.fail("a scene was made that is in the cache")


def same(one: SphereScene, other: SphereScene) -> bool:
    return all(torch.equal(a, b) and a.dtype == b.dtype for a, b in zip(one, other, strict=True))


def test_a_scene_is_made_once(cache: Path) -> None:
    assert same(sphere._kept("small", small), small())
    assert [path.name for path in cache.iterdir()] == ["sphere-small.safetensors"]
    assert same(sphere._kept("small", never), small())


def test_a_scene_of_other_code_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(kept, "_maker", lambda sources: "of another version")
        sphere._kept("small", lambda: sphere_scene(SIZE + 1))
    assert same(sphere._kept("small", small), small())
    assert same(sphere._kept("small", never), small())


@pytest.mark.parametrize("end", [0, 5, 200, -1])
def test_a_damaged_file_is_made_anew(end: int, cache: Path) -> None:
    sphere._kept("small", small)
    path = cache / "sphere-small.safetensors"
    path.write_bytes(path.read_bytes()[:end])
    assert same(sphere._kept("small", small), small())
    assert same(sphere._kept("small", never), small())


def test_a_cache_that_cannot_be_written_to_is_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path / "file" / "below"))
    assert same(sphere._kept("small", small), small())


@pytest.mark.parametrize("scene", [sphere.reference_scene, sphere.environment_scene])
def test_scenes_that_are_kept_are_those_of_every_picture(scene: object, cache: Path) -> None:
    """However a process came by them."""
    scene.cache_clear()  # type: ignore[attr-defined]
    made = scene()  # type: ignore[operator]
    scene.cache_clear()  # type: ignore[attr-defined]
    read = scene()  # type: ignore[operator]
    assert len(list(cache.glob("sphere-*"))) == 1
    assert same(made, read)

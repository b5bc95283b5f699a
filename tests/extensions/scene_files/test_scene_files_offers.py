"""The core without the extension: scenes of data sets are rendered, files of scenes are refused."""

from __future__ import annotations

import pytest

from data_tools.synthetic.cornell import random_scene, to_xml
from metapp.registry import WITHOUT
from metapp.rendering.scenes.loading import load_scene
from tests.needs_mitsuba import needs_mitsuba


@needs_mitsuba
def test_without_it_scenes_are_dictionaries_without_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(WITHOUT, "scene_files")
    box = random_scene(0)
    assert len(load_scene(box).scene.emitters()) == 1
    with pytest.raises(ValueError, match=r"a scene in XML, .*; XML needs the extension scene_files"):
        load_scene({"xml": to_xml(box)})
    mesh = {"type": "ply", "filename": "/etc/hostname"}
    with pytest.raises(ValueError, match=r"names the file '/etc/hostname', .* need the extension scene_files"):
        load_scene({**box, "more": mesh})

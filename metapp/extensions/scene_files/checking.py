"""Checks of scenes in XML, or that name files."""

from __future__ import annotations

from metapp.extensions.scene_files.places import Places
from metapp.extensions.scene_files.xml import checked_xml
from metapp.rendering.scenes.rules import CheckedDict, SceneDict


def checked(scene: SceneDict, places: Places, name: str = "") -> SceneDict:
    """The same scene, of the same form, with absolute file names, includes and defaults in it.

    Args:
        scene: a dictionary, or {"xml": text}.
        places: where its files may lie.
        name: resolved path of its file, if it has one.

    Raises:
        ValueError: something that a scene may not hold.
    """
    if not isinstance(scene, dict):
        raise ValueError("no scene, expected an object of type 'scene'.")
    if "xml" in scene:
        if not isinstance(scene["xml"], str):
            raise ValueError("an 'xml' that is no text, expected a document; change it.")
        return {"xml": checked_xml(scene["xml"], places, name)}
    return CheckedDict(places).object(scene)


def stored(scene: SceneDict) -> SceneDict:
    """The same scene of a data set, whose files must have been read in this process.

    Raises:
        ValueError: as `checked`.
    """
    return checked(scene, Places())

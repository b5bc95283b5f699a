"""Mitsuba scenes that paths can be traced in: checked, loaded, and refused if they cannot be.

A scene is an argument of Mitsuba's `load_dict` as JSON, with matrices as nested lists. Scenes of data sets may be the
text of an XML document, too, {"xml": text}, which the extension scene_files makes a dictionary of.

Mitsuba gets checked scenes alone, and no folder of a scene: it would run a library that lies there and that the
scene names as a plugin. All file names are absolute, and the files lie in folders that the user named.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.latlong import luminance
from metapp.registry import registry
from metapp.rendering.scenes.rules import (
    SCENE_FILE_READER,
    SceneChecker,
    SceneDict,
    SceneFiles,
    instantiate_scene,
    shorten_mitsuba_message,
)
from metapp.rendering.types import Emitter, Mitsuba, Scene
from metapp.rendering.variant import load_mitsuba


class LoadedScene(NamedTuple):
    """A scene in Mitsuba.

    Attributes:
        mitsuba: the module, in its variant.
        scene: Mitsuba's object.
        greatest_luminance: the greatest luminance that its lights send out; 0 if they do not tell.
    """

    mitsuba: Mitsuba
    scene: Scene
    greatest_luminance: float


def check_scene(scene: SceneDict) -> SceneDict:
    """Check a scene of a data set, and return it with absolute file names.

    An extension may check scenes in XML, and scenes with files that were read in this process before; without it, both
    are refused.

    Raises:
        ValueError: something that a scene may not hold.
    """
    if not isinstance(scene, dict):
        raise ValueError("no scene, expected an object of type 'scene'.")
    if entry := registry().hooks.get("scene"):
        result: SceneDict = entry.load()(scene)
        return result
    if "xml" in scene:
        raise ValueError(f"a scene in XML, expected a dictionary; XML needs {SCENE_FILE_READER}.")
    return SceneChecker(SceneFiles()).check_object(scene)


def load_scene(scene: SceneDict) -> LoadedScene:
    """Load a scene whose paths can be traced.

    Raises:
        ValueError: no Mitsuba that can render here; no scene that it can load; no light, or one that Mitsuba's own path
            tracer leaves dark; a sensor other than a perspective one; fog; a file that was not read before.
    """
    scene, mi = check_scene(scene), load_mitsuba()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        loaded = instantiate_scene(mi, scene)
    except Exception as error:  # whatever Mitsuba raises, the scene is to blame
        raise ValueError(f"no scene that Mitsuba can load: {mitsuba_message(error)}") from None
    _check_traceable(mi, loaded)
    greatest_luminance = max(_greatest_luminance(mi, emitter) for emitter in loaded.emitters())
    if not 0 <= greatest_luminance < math.inf:
        raise ValueError(
            f"a light of luminance {greatest_luminance}, expected a finite one of 0 or more; change its radiance."
        )
    return LoadedScene(mi, loaded, greatest_luminance)


def mitsuba_message(error: BaseException) -> str:
    """Return Mitsuba's message of an error, in one line."""
    return shorten_mitsuba_message(str(error.__cause__ or error))  # the cause of an error within a loop


def colour_luminance(radiance: Tensor) -> Tensor:
    """Return luminance [N] of linear Rec.709 [N, 3]."""
    return luminance(radiance.T[..., None])[:, 0]


def _check_traceable(mi: Mitsuba, scene: Scene) -> None:
    """Refuse a scene in Mitsuba whose paths cannot be traced.

    Raises:
        ValueError: no light, or one that paths cannot meet; a sensor other than a perspective one.
    """
    if not scene.emitters():
        raise ValueError("no emitter, expected an area light, an environment, a point or directional light; add one.")
    for emitter in scene.emitters():
        flags = emitter.flags()
        if mi.has_flag(flags, mi.EmitterFlags.Delta) and mi.has_flag(flags, mi.EmitterFlags.Surface):
            raise ValueError(
                f"an emitter {emitter.class_name()}, whose light no path tracer finds, expected another one; put a "
                "directional light or a small area light in its place."
            )
    if not scene.sensors():
        raise ValueError("no sensor, expected a perspective one; add it.")
    kind = scene.sensors()[0].class_name()
    if kind != "PerspectiveCamera":
        raise ValueError(f"a sensor {kind}, expected a perspective one; change its type to 'perspective'.")
    width, height = scene.sensors()[0].film().crop_size()
    if not width or not height:
        raise ValueError(f"a film of {width} x {height} px, expected 1 or more of both; change its crop.")


def _greatest_luminance(mi: Mitsuba, emitter: Emitter) -> float:
    """Return the greatest luminance that an emitter sends out; 0 if its parameters do not tell."""
    values = mi.traverse(emitter)
    for name in ("radiance.value", "radiance.data", "data"):
        if name in values:
            radiance = torch.from_numpy(np.array(values[name]))
            if not radiance.is_floating_point():  # 8-bit sRGB: linear values are no greater
                radiance = radiance / torch.iinfo(radiance.dtype).max
            shape = (1, -1) if name == "radiance.value" else (-1, radiance.shape[-1])
            colours = radiance.float().reshape(shape)[:, :3].expand(-1, 3)
            factor = np.array(values.get("scale", 1.0)).item() if name == "data" else 1.0  # a Dr.Jit array in envmaps
            return float(colour_luminance(colours * factor).max())
    return 0.0

"""Mitsuba scenes that paths can be traced in: loaded, and refused where they cannot be."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from data_tools.mitsuba_variant import load_mitsuba
from metapp.latlong import luminance


def load_scene(scene: dict[str, Any]) -> tuple[Any, Any, float]:
    mi = load_mitsuba()
    loaded = mi.load_dict(_matrices(mi, scene))
    return mi, loaded, max(_brightest(mi, emitter) for emitter in loaded.emitters())


def brightness(radiance: Tensor) -> Tensor:
    """Luminance [N] of linear Rec.709 [N, 3]."""
    return luminance(radiance.T[..., None])[:, 0]


def _brightest(mi: Any, emitter: Any) -> float:
    """The greatest luminance of an area light or environment; 0 where its parameters do not tell."""
    values = mi.traverse(emitter)
    for name, factor in (("radiance.value", 1.0), ("radiance.data", 1.0), ("data", values.get("scale", 1.0))):
        if name in values:
            radiance = torch.from_numpy(values[name].numpy()).float()
            shape = (1, -1) if name == "radiance.value" else (-1, radiance.shape[-1])
            colours = radiance.reshape(shape)[:, :3].expand(-1, 3)
            return float(brightness(colours * float(factor)).max())
    return 0.0


def _matrices(mi: Any, scene: Any) -> Any:
    """The same with the matrices as Mitsuba wants them."""
    if not isinstance(scene, dict):
        return scene
    return {
        key: mi.ScalarTransform4f(value) if key == "to_world" and isinstance(value, list) else _matrices(mi, value)
        for key, value in scene.items()
    }

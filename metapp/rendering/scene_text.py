"""A scene dictionary as the tensor that tasks hold, and back."""

from __future__ import annotations

import json
import math
from typing import Any

import torch
from torch import Tensor

Json = Any  # a value of a scene
SceneDict = dict[str, Any]  # as Mitsuba's `load_dict` takes it, as far as JSON holds it
BYTES = 8192  # of a scene as text: one size, so that sets of tasks can be joined


def scene_bytes(scene: SceneDict) -> Tensor:
    """A scene as its JSON text, uint8 [L], with blanks at its end up to a multiple of 8192 bytes."""
    text = json.dumps(scene, allow_nan=False).encode()
    padded = text.ljust(math.ceil(len(text) / BYTES) * BYTES)
    return torch.frombuffer(bytearray(padded), dtype=torch.uint8)


def scene_of(text: Tensor) -> SceneDict:
    """The scene whose JSON text this is, as `scene_bytes` makes it.

    Raises:
        ValueError: it is no JSON.
    """
    try:
        result: SceneDict = json.loads(text.cpu().numpy().tobytes())
        return result
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a stored scene is no JSON ({error}), expected a dictionary; make the data anew.") from None

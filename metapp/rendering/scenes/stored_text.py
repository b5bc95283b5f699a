"""Scenes as tasks hold them: their JSON text, in a tensor.

A task has tensors alone, so that a scene travels with its samples in data sets and over processes.
"""

from __future__ import annotations

import json
import math

import torch
from torch import Tensor

from metapp.rendering.scenes.rules import SceneDict

TEXT_BLOCK_BYTES = (
    8192  # texts fill whole blocks of this size, so that most have one length and sets of tasks can be joined
)


def encode_scene(scene: SceneDict) -> Tensor:
    """Return a scene as its JSON text, uint8 [L], with blanks at its end up to a multiple of 8192 bytes."""
    text = json.dumps(scene, allow_nan=False).encode()
    padded = text.ljust(math.ceil(len(text) / TEXT_BLOCK_BYTES) * TEXT_BLOCK_BYTES)
    return torch.frombuffer(bytearray(padded), dtype=torch.uint8)


def decode_scene(text: Tensor) -> SceneDict:
    """Return the scene whose JSON text :func:`encode_scene` made.

    Raises:
        ValueError: it is no JSON.
    """
    try:
        result: SceneDict = json.loads(text.cpu().numpy().tobytes())
        return result
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a stored scene is no JSON ({error}), expected a dictionary; make the data anew.") from None

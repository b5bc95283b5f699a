"""The nouns: what a task is, what an application is, and the one tree that all parameters live in."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

Params = dict[str, Tensor]


class Task(NamedTuple):
    """One thing to reproduce: a material, a texture, a map, a scene.

    Attributes:
        name: what tables and files call it.
        data: its observations, by name, without a task axis; the application says which it needs.
    """

    name: str
    data: dict[str, Tensor]

"""The texture that fits of textures answer with."""

from __future__ import annotations

from metapp.appearance.assets import Texture
from metapp.apps.texture import app as texture_app
from metapp.learning.task import Params, Task, add_task_axis


def make_texture(app: texture_app.Texture, theta: Params, task: Task, size: tuple[int, int] | None) -> Texture:
    """Return the texture of a fit, which tiles; see :class:`metapp.application.MakeAsset`."""
    return Texture(app.draw_tile(add_task_axis(theta), task, size))

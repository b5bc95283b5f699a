"""The baseline of networks of stationary svBRDFs: the nearest training material."""

from __future__ import annotations

from metapp.baselines.baseline import Baseline
from metapp.baselines.texture import nearest_exemplar
from metapp.learning.app import App


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of flash photographs of stationary materials."""
    cannot = "be a material that is not in its set, nor be lit from elsewhere: it is a photograph"
    return (Baseline("nearest", "the training photograph with the least error", cannot, nearest_exemplar),)

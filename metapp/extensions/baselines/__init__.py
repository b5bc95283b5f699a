"""Baselines: what a reader would use instead of a network, fitted to what fits see and judged by the same errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metapp import door

if TYPE_CHECKING:
    from metapp.extensions.baselines.baseline import Baseline
    from metapp.learning.app import App

_HERE = "metapp.extensions.baselines"
OFFERS = (
    door.Command("baseline", f"{_HERE}.commands:baseline"),
    door.Table("baselines", f"{_HERE}.table:BASELINES"),
    door.Baselines("brdf", ("pca_20", "pca_66", "pca_150", "ggx_2", "nearest"), f"{_HERE}.brdf:baselines"),
    door.Baselines("illumination", ("sh", "unwrap"), f"{_HERE}.illumination:baselines"),
    door.Baselines("svbrdf_nonstationary", ("flat", "predicted"), f"{_HERE}.svbrdf_nonstationary:baselines"),
    door.Baselines("svbrdf_stationary", ("nearest", "quilting"), f"{_HERE}.svbrdf_stationary:baselines"),
    door.Baselines("texture", ("nearest", "quilting"), f"{_HERE}.texture:baselines"),
)


def baselines_of(app: App) -> tuple[Baseline, ...]:
    """The baselines of an application under its protocol; () where no extension offers any."""
    methods = (door.load(offer.baselines)(app) for offer in door.offers_of(door.Baselines, app.name))
    return tuple(method for some in methods for method in some)

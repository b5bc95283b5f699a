"""Recipes that follow from others: smaller ones, and those of both protocols."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from metapp.learning.app import App
from metapp.learning.recipe import Recipe, paper_recipe


def recipes_by_protocol(
    quick: Recipe, photo: Recipe, *, full: Mapping[str, App], paper: Mapping[str, App]
) -> dict[str, dict[str, Recipe]]:
    """Return the recipes of an application whose fits see the thing itself or one photograph of it, by protocol.

    Args:
        quick: of fits that see the thing itself.
        photo: of fits of photographs, of the same size.
        full, paper: the application at the size that people use and at the paper's, by "reference" and "photo".
    """
    published = paper_recipe(quick, paper["reference"])
    of_photos = replace(
        published, app=paper["photo"], overfit=photo.overfit, finetune=photo.finetune, quickft=photo.quickft
    )
    return {
        "reference": {"paper": published, "quick": quick, "full": replace(quick, app=full["reference"])},
        "photo": {"paper": of_photos, "quick": photo, "full": replace(photo, app=full["photo"])},
    }

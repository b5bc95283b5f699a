"""The table of recipes of an application with two protocols: fits of the thing itself, and of one photograph of it.

Two applications have such tables, which differ in their networks and in how they are trained. None is known here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from metapp.learning.app import App
from metapp.learning.recipe import Recipe, paper_recipe


def recipes_by_protocol(
    quick: Recipe, photo: Recipe, *, full: Mapping[str, App], paper: Mapping[str, App]
) -> dict[str, dict[str, Recipe]]:
    """Return the recipes "paper", "quick" and "full" of an application, by protocol: "reference" and "photo".

    Args:
        quick: the recipe "quick" of fits that see the thing itself.
        photo: the recipe "quick" of fits that see one photograph, of equal size.
        full, paper: the application at the size that people use, and at the paper's, by protocol.
    """
    published = paper_recipe(quick, paper["reference"])
    photo_paper = replace(
        published, app=paper["photo"], overfit=photo.overfit, finetune=photo.finetune, quickft=photo.quickft
    )
    return {
        "reference": {"paper": published, "quick": quick, "full": replace(quick, app=full["reference"])},
        "photo": {"paper": photo_paper, "quick": photo, "full": replace(photo, app=full["photo"])},
    }

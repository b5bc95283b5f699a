"""The default BRDF set: isotropic materials from reflection models, drawn to be as varied as a measured set.

Every material is reciprocal, non-negative and reflects no more than it receives. Families take turns, so any count
holds a mix of them; within a family, hue, roughness and lightness follow a low-discrepancy sequence, so a small set
still covers the range. Random numbers are PCG64's raw uniforms, equal on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.brdf_task import UNITS as UNITS
from data_tools.readers.brdf_task import make_brdf_task
from data_tools.readers.merl import tabulate_merl, write_merl
from data_tools.synthetic.brdf_anisotropic import anisotropic_materials
from data_tools.synthetic.brdf_draws import COUNTS as COUNTS
from data_tools.synthetic.brdf_draws import Draws, SyntheticBrdf, colour_name, roughness_name
from data_tools.synthetic.brdf_models import (
    CONDUCTORS,
    IsotropicModel,
    absorbing_layer,
    conductor,
    dielectric_coating,
    diffuse,
    flakes,
    isotropic_mixture,
    oren_nayar,
    plastic,
    sheen,
)
from data_tools.synthetic.random_values import Split
from metapp.appearance.geometry import Cosines, angle_cosines
from metapp.learning.task import Task

VERSION = 3  # of the set's tasks; 2 added pictures under an environment map, 3 phi_d over the full circle


def _draw_conductor(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a bare metal from CONDUCTORS, from polished to rough."""
    metal = list(CONDUCTORS)[int(draw.hue * len(CONDUCTORS))]
    alpha = draw.alpha(0.03, 0.5)
    return f"{metal}-{roughness_name(alpha)}", conductor(*CONDUCTORS[metal], alpha, draw.kind())


def _draw_plastic(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a plastic with a satin to rough coat."""
    colour, alpha = draw.colour(), draw.alpha(0.12, 0.6)
    return f"{colour_name(colour)}-{roughness_name(alpha)}", plastic(colour, alpha, draw.kind(), draw.between(1.4, 1.7))


def _draw_glossy(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a plastic with a polished coat."""
    colour, alpha = draw.colour(0.01), draw.alpha(0.03, 0.12)
    return f"{colour_name(colour)}-{roughness_name(alpha)}", plastic(colour, alpha, draw.kind(), draw.between(1.4, 1.7))


def _draw_coated_metal(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a metal under a coloured layer and a smooth coat."""
    metal = ("aluminium", "chromium", "silver", "titanium", "iron", "iridium")[int(draw.between(0, 6))]
    tint, alpha = draw.colour(0.5, 0.98, (0.1, 0.75)), draw.alpha(0.08, 0.45)
    body = absorbing_layer(conductor(*CONDUCTORS[metal], alpha, draw.kind()), tint)
    return f"{colour_name(tint)}-{metal}-{roughness_name(alpha)}", dielectric_coating(
        body, draw.between(0.03, 0.12), "ggx"
    )


def _draw_paint(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a paint: metal flakes in a coloured ground under a polished coat."""
    colour, alpha = draw.colour(0.15, 0.85, (0.2, 0.9)), draw.alpha(0.2, 0.55)
    ground = diffuse(draw.colour(0.02, 0.35, (0.3, 1)))
    body = isotropic_mixture(flakes(colour, alpha), ground, draw.between(0.35, 0.85))
    return f"{colour_name(colour)}-{roughness_name(alpha)}", dielectric_coating(
        body, draw.between(0.03, 0.08), draw.kind()
    )


def _draw_fabric(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a satin or a velvet."""
    colour, pile = draw.colour(0.02, 0.7), draw.between(0, 0.6)
    red, green, blue = (pile + (1 - pile) * channel for channel in colour)
    body = oren_nayar(colour, draw.between(0.3, 0.9))
    if draw.chance(0.4):  # satin weaves have a broad highlight as well
        body = dielectric_coating(body, draw.between(0.3, 0.5), "beckmann", 1.46)
        return f"{colour_name(colour)}-satin", sheen(body, (red, green, blue), 0.15 + 0.35 * draw.roughness)
    return f"{colour_name(colour)}-velvet", sheen(body, (red, green, blue), 0.2 + 0.6 * draw.roughness)


def _draw_diffuse(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw a matt material: Lambert's, or Oren and Nayar's."""
    colour = draw.colour(0.02, 0.95)
    if draw.chance(0.4):
        return f"{colour_name(colour)}-lambert", diffuse(colour)
    return f"{colour_name(colour)}-oren-nayar", oren_nayar(colour, 0.2 + 0.8 * draw.roughness)


def _draw_mixture(draw: Draws) -> tuple[str, IsotropicModel]:
    """Draw materials of two families side by side, finer than the eye."""
    families = [_draw_conductor, _draw_plastic, _draw_glossy, _draw_paint, _draw_diffuse]
    first = int(draw.between(0, 5))
    second = (first + int(draw.between(1, 5))) % 5
    first_name, first_model = families[first](draw)
    draw.hue, draw.lightness = (draw.hue + draw.between(0.2, 0.8)) % 1, 1 - draw.lightness
    second_name, second_model = families[second](draw)
    return f"{first_name}-on-{second_name}", isotropic_mixture(first_model, second_model, draw.between(0.25, 0.75))


_FAMILIES: dict[str, Callable[[Draws], tuple[str, IsotropicModel]]] = {
    "conductor": _draw_conductor,
    "plastic": _draw_plastic,
    "glossy": _draw_glossy,
    "coated": _draw_coated_metal,
    "paint": _draw_paint,
    "fabric": _draw_fabric,
    "diffuse": _draw_diffuse,
    "mixture": _draw_mixture,
}
# Twenty turns, with about the shares that families have in the MERL set: more metals and glossy coats than fabrics and
# chalk.
_TURNS = """
    conductor plastic glossy paint conductor fabric coated plastic diffuse glossy
    conductor paint mixture plastic conductor glossy coated fabric diffuse mixture
"""


def _evaluator(model: IsotropicModel) -> Callable[[Tensor], Tensor]:
    """Return the function that evaluates a model at angles [..., 3] in rad, 0 below the horizon."""

    def evaluate(angles: Tensor) -> Tensor:
        cosines = angle_cosines(angles)
        above_horizon = (cosines.incident > 0) & (cosines.outgoing > 0)
        # Below the horizon a model may be anything; a harmless place keeps values and gradients finite.
        safe_cosines = Cosines(
            cosines.incident.clamp_min(1e-6), cosines.outgoing.clamp_min(1e-6), cosines.half, cosines.difference
        )
        return torch.where(above_horizon[..., None], model(safe_cosines), 0.0)

    return evaluate


def synthetic_materials(split: Split, count: int | None = None, seed: int = 0) -> list[SyntheticBrdf]:
    """Draw the isotropic materials of one split.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many; by default 80 for training, 20 for the test. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.

    Returns:
        Materials with unique names such as "conductor-gold-rough-07" ("-t07" in the test split).

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    if split not in COUNTS:
        raise ValueError(f"split of the synthetic BRDFs: {split!r}, expected 'train' or 'test'")
    count = COUNTS[split] if count is None else count
    if count < 0 or seed < 0:
        raise ValueError(f"synthetic BRDFs: count {count} and seed {seed}, expected both to be 0 or more")
    turns, drawn_counts = _TURNS.split(), dict.fromkeys(_FAMILIES, 0)
    materials = []
    for index in range(count):
        family = turns[index % len(turns)]
        draw = Draws(split, seed, list(_FAMILIES).index(family), drawn_counts[family])
        drawn_counts[family] += 1
        description, model = _FAMILIES[family](draw)
        number = f"{'t' if split == 'test' else ''}{index:02d}"
        materials.append(SyntheticBrdf(f"{family}-{description}-{number}", _evaluator(model)))
    return materials


def synthetic_tasks(split: Split, count: int, seed: int = 0, *, anisotropic: bool = False) -> Iterator[Task]:
    """Draw the materials of one split, and yield each as a task.

    All tasks have the samples of seed 0, so that they share their angles.

    Args:
        split: "train" or "test"; both have all families, with other draws.
        count: how many. A larger set begins with the smaller one.
        seed: seed of the materials, >= 0.
        anisotropic: draw from `data_tools.synthetic.brdf_anisotropic` instead of the isotropic families.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for material in (anisotropic_materials if anisotropic else synthetic_materials)(split, count, seed):
        yield make_brdf_task(material.name, material.evaluate, azimuths=anisotropic)


def write_merl_files(folder: str | Path, split: Split, count: int, seed: int = 0) -> Iterator[str]:
    """Tabulate isotropic materials as MERL files of 35 MB, `<folder>/<name>.binary`, one by one.

    The materials are those that :func:`synthetic_materials` draws with `split`, `count` and `seed`.

    Returns:
        The materials' names, each once its file is written.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    for material in synthetic_materials(split, count, seed):
        write_merl(Path(folder) / f"{material.name}.binary", tabulate_merl(material.evaluate))
        yield material.name


# Other forms that the set can be written in: the function `write(folder, split, count, seed)`, which yields the
# names of the files, and the bytes of one file.
FILES = {"merl": (write_merl_files, 34_992_012)}

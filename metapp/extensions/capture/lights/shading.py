"""Directions of the light checked by the shading of the scene, which a linear model of all photographs predicts.

The radiance of a matt surface is linear in the direction of a distant lamp (photometric stereo: Woodham 1980), so that
a photograph tells its lamp's direction by the others, roughly, if the scene has relief.
"""

from __future__ import annotations

import numpy as np

from data_tools.readers.colours import Floats

MIN_CHECKED_PHOTOS = 10  # fewer do not predict one of them
MAX_DEVIATION_DEGREES = 30.0  # between a direction and the one by which the shading is explained best
_MIN_ERROR_RATIO = 2.0  # of the error of a direction over the error of that best one, relative to other photographs


def find_contradictions(pictures: Floats, directions: Floats) -> dict[int, float]:
    """Find directions that the shading of the scene contradicts: the photographs' numbers, and by how many degrees.

    Each photograph is predicted by a linear model of the others. Its direction is contradicted if another one predicts
    it much better, and lies far away. The worst one is taken out, and the others are checked again.

    Args:
        pictures: photographs of the scene without the balls, as lists of values in linear light, [N, P].
        directions: the directions, [N, 3], of unit length.
    """
    contradicted: dict[int, float] = {}
    numbers = np.arange(len(directions))
    while len(numbers) >= max(MIN_CHECKED_PHOTOS, 2 * len(directions) // 3):
        ratios, degrees = _compare_with_shading(pictures[numbers], directions[numbers])
        is_wrong = (ratios > _MIN_ERROR_RATIO * np.median(ratios)) & (degrees > MAX_DEVIATION_DEGREES)
        if not is_wrong.any():
            break
        worst = int(np.where(is_wrong, ratios, 0).argmax())
        contradicted[int(numbers[worst])] = float(degrees[worst])
        numbers = np.delete(numbers, worst)
    return contradicted


def _compare_with_shading(pictures: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return how much worse than the best direction each direction predicts its photograph, and how far off it is.

    Returns:
        The ratio of their errors, at least about 1, [N]; the angle between them in degrees, [N].
    """
    ratios, degrees = [], []
    terms = np.concatenate([directions, np.ones((len(directions), 1))], 1)
    for number, picture in enumerate(pictures):
        model = np.linalg.lstsq(np.delete(terms, number, 0), np.delete(pictures, number, 0), rcond=None)[0]
        predicted = terms[number] @ model
        gain = picture @ predicted / max(float(predicted @ predicted), 1e-12)
        best = np.linalg.lstsq(model.T, picture, rcond=None)[0]
        errors = [float(np.linalg.norm(picture - values)) for values in (gain * predicted, best @ model)]
        ratios.append(errors[0] / max(errors[1], 1e-12))
        cosine = best[:3] @ directions[number] / max(float(np.linalg.norm(best[:3])), 1e-12)
        degrees.append(float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))))
    return np.array(ratios), np.array(degrees)

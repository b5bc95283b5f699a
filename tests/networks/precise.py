"""Parameters in float64, for comparisons to rounding."""

from metapp.learning.task import Params


def double(params: Params) -> Params:
    return {key: value.double() for key, value in params.items()}

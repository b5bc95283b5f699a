"""What help and completion must know at once, without importing the applications; a test holds it against what is."""

from __future__ import annotations

from typing import NamedTuple

from metapp.evaluation.tables import NAMES, STUDIES

RULE_NAMES = (
    "meta-sgd",
    "meta-adam",
    "meta-adam-tied",
    "meta-curvature",
    "meta-encoder",
    "meta-lgd",
    "meta-mean",
    "meta-basis",
    "meta-axes",
    "ridge",
)
PART_NAMES = (
    *("adam", "tied", "sgd", "rates", "shared", "solve", "betas", "loss", "pace", "eps"),
    *("curvature", "network", "average", "basis"),
)
DEVICES = ("auto", "cpu", "cuda")
ALL = "all"
WHICH = (*NAMES, ALL, *STUDIES)  # tables of `metapp evaluate`


class Known(NamedTuple):
    """What an application has.

    Attributes:
        recipes: their names, of all protocols.
        observe: its protocols.
        methods: its baselines that need no fit of Meta, of all protocols.
        options: of `size`, `detail`, `render` and `exposures` those that it has.
    """

    recipes: tuple[str, ...] = ("quick", "full", "paper")
    observe: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    options: tuple[str, ...] = ("size", "detail", "render", "exposures")


_PHOTO = ("reference", "photo")
KNOWN = {
    "brdf": Known(
        ("quick", "full", "paper", "measured", "few", "anisotropic"),
        methods=("pca_20", "pca_66", "pca_150", "pca_20w", "pca_66w", "pca_150w", "ggx_1", "ggx_2", "nearest"),
        options=(),
    ),
    "illumination": Known(
        observe=_PHOTO,
        methods=("halves", "haar", "dct", "sh", "nearest", "unwrap", "gaussian"),
        options=("size", "exposures"),
    ),
    "svbrdf_nonstationary": Known(
        ("quick", "full", "paper", "several"), _PHOTO, ("jpeg", "png", "nearest", "flat", "predicted"), ()
    ),
    "svbrdf_stationary": Known(methods=("nearest", "quilting"), options=("size", "detail")),
    "texture": Known(
        ("quick", "full", "paper", "paper-vgg19"),
        methods=("nearest", "quilting", "gpdm", "patches"),
        options=("size", "detail"),
    ),
    "transport": Known(methods=("histogram", "histogram_8"), options=("render",)),
}


def known_of(app: str) -> Known:
    """What an application has; of one that is not listed, what most have."""
    return KNOWN.get(app, Known())

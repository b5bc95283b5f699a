"""The doubts about fits that show without a reference: for each kind the limit of a figure, and one sentence.

A figure is measured where its kind of fit is at home; here stands when it is said, and how. Records keep the sentences,
and commands print them. A doubt never ends a fit.
"""

from __future__ import annotations

from typing import NamedTuple


class Doubt(NamedTuple):
    """A kind of doubt about a fit.

    Attributes:
        limit: the value of the figure beyond which the fit is doubted.
        sentence: the clause, in which {figure}, {limit}, {in_percent} (100 times the figure), {percent} (the figure as
            a percentage of two digits) and further words by name are filled in.
        is_least: whether a fit is doubted below the limit; else it is above.

    >>> Doubt(0.5, "keeps {figure:.2f} of it", is_least=True).about(0.25)
    ['keeps 0.25 of it']
    """

    limit: float
    sentence: str
    is_least: bool = False

    def about(self, figure: float, **words: object) -> list[str]:
        """Return the clause if a figure is beyond the limit, else []; NaN, of what cannot be measured, is not.

        Args:
            figure: the figure.
            words: further words of the sentence, by name.
        """
        if not (figure < self.limit if self.is_least else figure > self.limit):
            return []
        known = {"figure": figure, "limit": self.limit, "in_percent": 100 * figure, "percent": format_percent(figure)}
        return [self.sentence.format(**known, **words)]


def format_percent(share: float) -> str:
    """Write a share in [0, 1] as a percentage of two digits.

    >>> format_percent(0.01234), format_percent(1.0)
    ('1.2 %', '100 %')
    """
    return f"{float(f'{100 * share:.2g}'):g} %"


# Pictures that are made of an exemplar

LOST_ORDER = Doubt(
    0.5,  # share of an exemplar's order that a picture keeps; quilting keeps 0.68 to 1.0
    "keeps {figure:.2f} of the photo's regular structure (a photo that shows it more often helps)",
    is_least=True,
)
_BROKEN_LINES = (
    "breaks lines of the photo such as joints, cracks or threads ({figure:.2f} as strong, expected {limit:g} or more, "
    "a photo that shows them more often helps)"
)
# strength of a picture's lines over the exemplar's: of textures 5 of 66 fits of photographs are below
BROKEN_LINES_OF_TEXTURE = Doubt(0.935, _BROKEN_LINES, is_least=True)
BROKEN_LINES_OF_MATERIAL = Doubt(0.85, _BROKEN_LINES, is_least=True)
VISIBLE_CUTS = Doubt(
    1.3,  # change across the cuts of a quilt over the exemplar's, above which cuts are seen
    "shows the cuts between pieces of the photo (changes across them are {figure:.1f} times as strong as the photo's, "
    "a photo that shows its structure more often helps)",
)
REPETITION = Doubt(
    0.2,  # share of a quilt that comes back at one shift, above which an eye finds it
    "repeats {figure:.0%} of itself (a photo of more of the material helps)",
)
BROKEN_ROWS = Doubt(
    # how unlike the photo relief is across cuts, over how unlike itself the photo is; see README.md of the checkpoint
    1.25,
    "breaks rows of the relief at cuts, as lit_from_left.png shows ({figure:.2f} times as unlike the photo as the "
    "photo is, expected {limit:g} or less, a photo that shows them more often helps)",
)
GUESSED_RELIEF = Doubt(
    1.0,  # mean tilt of normals in degrees
    "relief, tilted by {figure:.1f} degrees on average, is a guess, as one photo hardly tells it",
)

# Materials in photographs

# This share lies between photos that show next to nothing clipped (< 0.1 % of px) and photos of which 0.5 % or more is.
# The highlight of a flat material whose photo has 1 % of clipped px gives an F0 of at least 0.75 of the true one, of
# photos with more clipped px down to 0.34 (9 in 10 of 136 renderings, roughness 0.16 to 0.6, F0 up to 1).
CLIPPED_HIGHLIGHT = Doubt(0.002, "{percent} of {subject} is clipped, {effect} (a darker exposure shows more)")
HIDDEN_COLOURS = Doubt(
    0.01,  # share of the photo's texels
    "{percent} of the photo lies beneath a highlight: colours and gloss there are guesses",
)
FLAT_RELIEF = Doubt(
    3.0,  # mean tilt of normals in degrees
    "the surface is nearly flat, with normals tilted by {figure:.1f} degrees on average: relief is about as large as "
    "its errors",
    is_least=True,
)
UNEXPLAINED_AREAS = Doubt(
    0.02,  # deviation of the logs of photographs from those of renderings, over blocks
    "photos differ from pictures of the maps by {in_percent:.0f} % over wide areas: a place, a flash or the surface is "
    "not as assumed, and maps may be wrong",
)
UNEXPLAINED_TEXELS = Doubt(
    0.01,  # median |difference| of the logs of photographs and renderings; exact places have 0.002
    "photos differ from pictures of the maps by {in_percent:.1f} % from texel to texel, expected up to 1 %: by relief "
    "that moves as the camera does, by places or by the camera's colours; relief may be wrong",
)
# Directions predict left-out photographs better than the mean photograph: by 4.3 dB or more on 30 rendered domes, by
# 2.1 dB or less if they are the directions of other photographs
UNRELATED_LAMPS = Doubt(
    3.0,
    "directions to lamps predict photos that are left out by {figure:.1f} dB better than the mean photo does, expected "
    "{limit:g} or more: they are those of other photos, or too few; all is a guess",
    is_least=True,
)

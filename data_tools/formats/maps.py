"""Materials whose maps are separate images; fits take them as `svbrdf`."""

from __future__ import annotations

from data_tools.formats import Format, Setting
from data_tools.formats.images import SIZE

HELP = """Convert materials whose maps are separate images, such as rock_diffuse.png beside rock_normal.png.

Base colour (diffuse, albedo, basecolor, color), normal, roughness or gloss, and, where there are any, specular or
metallic; any case and format. Colours of 8 or 16 bit are sRGB. Of each map the central square is taken, scaled to
--size, and the photograph under a flash is rendered. A bad material is skipped with a warning.

A colour without such a word, rock.png beside rock_norm.png and rock_gloss.png, is an old game's: its gloss is how
strongly a highlight shines, which is converted to a roughness.

Examples:
  metapp data maps materials --out svbrdf
  metapp data maps materials/rock --normals directx --split test --out rock
"""
SPLIT = (
    "Where the tasks belong. auto: of the sorted names, every fifth is a test task; variants with the same normal map "
    "stay together."
)
NORMALS = Setting(
    "normals",
    "auto",
    "Where the green of normals points: up (opengl) or down (directx). auto: as names say (gl, dx), else as a height "
    "field could have it.",
    choices=("opengl", "directx", "auto"),
)

FORMAT = Format(
    "maps",
    "svbrdf_nonstationary",
    "data_tools.readers.material_maps",
    noun="material",
    help=HELP,
    paths=("FOLDERS...", "Folders of maps, searched at any depth."),
    settings=(SIZE, NORMALS),
    split_help=SPLIT,
)

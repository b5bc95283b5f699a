"""What fits of non-stationary svBRDFs take: strips, materials as maps, plain flash photographs."""

from __future__ import annotations

from data_tools.formats import Format

FORMAT = Format(
    "svbrdf",
    "svbrdf_nonstationary",
    "data_tools.readers.svbrdf_inputs",
    "flash photos, strips, a material's maps",
    takes=("size", "fov_rad"),
)

"""What fits of non-stationary svBRDFs take: strips, materials as maps, plain flash photographs."""

from __future__ import annotations

from data_tools.formats import Files, Format


def _files() -> Files:
    from data_tools.readers import svbrdf_inputs

    return svbrdf_inputs


FORMAT = Format(
    "svbrdf",
    "svbrdf_nonstationary",
    "flash photos, strips, a material's maps",
    _files,
    takes_fov=True,
    takes_size=True,
)

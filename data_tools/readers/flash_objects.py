"""Flash photographs in memory, and materials in memory that are photographed; as files."""

from __future__ import annotations

from pathlib import Path

from data_tools.readers import map_objects, material_maps
from metapp.storage.images import write_png

LARGEST = 2048  # px a side of the photograph of maps


def to_file(source: object, name: str, folder: Path, observe: str) -> Path:
    """Write a flash photograph in memory as an image file.

    Args:
        source: a picture; or a material, as `data_tools.readers.map_objects.to_file` takes it, which is rendered under
            the flash.
        name: of the file.
        folder: where to.
        observe: what fits see; of no use here.

    Raises:
        ValueError: as the same, and as `material_maps.read_task`.
    """
    path = map_objects.to_file(source, name, folder, observe)
    if path.stem == name:
        return path
    photo = material_maps.read_task(path, LARGEST, least=1).data["photo"]
    path = folder / f"{name}.png"
    write_png(photo.permute(1, 2, 0) / 255, {"encoding": "sRGB"}, path)
    return path

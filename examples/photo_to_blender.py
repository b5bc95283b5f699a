"""From a phone photo to Blender, and to any program that opens glTF: photo_to_blender.py PHOTO FOLDER

PHOTO shows a flat material from straight above, taken with the flash on in the dark. Into FOLDER go an asset folder
(PNG of 16 bits and material.json), pictures with the names that Blender's Node Wrangler knows, and a .glb file. In
Blender, import the .glb by File > Import > glTF 2.0; or select a Principled BSDF, press Ctrl+Shift+T and choose all
pictures.
"""

import json
import sys
from pathlib import Path

import metapp

photo, folder = map(Path, sys.argv[1:])
fit = metapp.fit("svbrdf_nonstationary", photo, observe="photo")
for form in ("asset", "blender", "gltf"):
    fit.export(form, folder / form / fit.name, overwrite=True)
description = json.loads((folder / "asset" / fit.name / "material.json").read_text(encoding="utf-8"))
size, height = description["size"], description["files"][f"{fit.name}_height.png"]
print(f"{fit.name}: {size['width']} x {size['height']} texels, fitted in {fit.seconds:.2f} s")
print(f"height: {height['scale']:.4f} of the width from the lowest to the highest texel")
for path in sorted(folder.glob("*/*")):
    print(path if path.is_file() else f"{path}: {len(list(path.iterdir()))} files")

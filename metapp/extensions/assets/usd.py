"""The USD export: a square with a UsdPreviewSurface in its specular workflow, which holds F0 itself.

Files are written by usd-core (`pip install "metapp[export]"`): a folder with a layer and its textures, and one .usdz
package. Pictures are PNG of 8 bits, which all viewers of USD read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdUtils, Vt

from metapp.appearance.assets import Surface
from metapp.extensions.assets.planes import all_surface_maps
from metapp.extensions.assets.surface_pictures import describe_provenance, write_surface_map
from metapp.storage.files import write_bytes

USD_PNG_BITS = 8
TEXTURES_FOLDER = "textures"
PREVIEW_SURFACE_INPUTS = {  # by the input of UsdPreviewSurface: the map, the output of its texture, the type
    "diffuseColor": ("diffuse", "rgb", "Color3f"),
    "specularColor": ("specular", "rgb", "Color3f"),
    "roughness": ("roughness", "r", "Float"),
    "normal": ("normal_gl", "rgb", "Normal3f"),
    "occlusion": ("ao", "r", "Float"),
}


def write_usd(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>.usda with its textures, and <path>/<name>.usdz, a package of all; `name` ends `path`."""
    surface_maps = all_surface_maps(surface)
    for key, _, _ in PREVIEW_SURFACE_INPUTS.values():
        write_surface_map(surface_maps[key], path / TEXTURES_FOLDER / f"{path.name}_{key}.png", USD_PNG_BITS)
    text = usd_layer_text(surface, path.name, provenance)
    layer = path / f"{path.name}.usda"
    write_bytes(layer, text.encode())
    package = path / f"{path.name}.usdz"
    if not UsdUtils.CreateNewARKitUsdzPackage(Sdf.AssetPath(str(layer)), str(package)):
        raise ValueError(f"{package}: not written by usd-core; is the disk full?")


def usd_layer_text(surface: Surface, name: str, provenance: Mapping[str, object]) -> str:
    """Return the text of a USD layer: one prim that holds a rectangle and its material."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{Tf.MakeValidIdentifier(name)}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    root.GetPrim().SetDocumentation(f"{name}, fitted by metapp: {describe_provenance(provenance)}")
    mesh = _define_rectangle(stage, root.GetPath().AppendChild("Square"), surface)
    material = _define_material(stage, root.GetPath().AppendChild("Material"), name, surface.tiles)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    text: str = stage.GetRootLayer().ExportToString()
    assert Sdf.Layer.CreateAnonymous(".usda").ImportFromString(text)
    return text


def _define_rectangle(stage: Usd.Stage, path: Sdf.Path, surface: Surface) -> UsdGeom.Mesh:
    """Add a rectangle of width 1 that faces +z to a stage."""
    half_height = surface.size[0] / surface.size[1] / 2
    mesh = UsdGeom.Mesh.Define(stage, path)
    corners = [(-0.5, -half_height, 0), (0.5, -half_height, 0), (0.5, half_height, 0), (-0.5, half_height, 0)]
    mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*corner) for corner in corners]))
    mesh.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*corners[0]), Gf.Vec3f(*corners[2])]))
    mesh.CreateFaceVertexCountsAttr([4])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(Vt.Vec3fArray([Gf.Vec3f(0, 0, 1)] * 4))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    texture_coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.varying
    )
    texture_coordinates.Set(Vt.Vec2fArray([Gf.Vec2f(*coordinates) for coordinates in ((0, 0), (1, 0), (1, 1), (0, 1))]))
    return mesh


def _define_material(stage: Usd.Stage, path: Sdf.Path, name: str, tiles: bool) -> UsdShade.Material:
    """Add a material with a UsdPreviewSurface and a texture for each of its inputs to a stage."""
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
    reader = UsdShade.Shader.Define(stage, path.AppendChild("Place"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    coordinates = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    for input_, (key, output, kind) in PREVIEW_SURFACE_INPUTS.items():
        texture = _define_texture(stage, path.AppendChild(key), f"./{TEXTURES_FOLDER}/{name}_{key}.png", key, tiles)
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
        texture_output = texture.CreateOutput(
            output, Sdf.ValueTypeNames.Float3 if output == "rgb" else Sdf.ValueTypeNames.Float
        )
        shader.CreateInput(input_, getattr(Sdf.ValueTypeNames, kind)).ConnectToSource(texture_output)
    surface_output = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(surface_output)
    return material


def _define_texture(stage: Usd.Stage, path: Sdf.Path, file: str, key: str, tiles: bool) -> UsdShade.Shader:
    """Add a texture that reads an image file to a stage."""
    texture = UsdShade.Shader.Define(stage, path)
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(file))
    is_colour = key in ("diffuse", "specular")
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB" if is_colour else "raw")
    for axis in ("wrapS", "wrapT"):
        texture.CreateInput(axis, Sdf.ValueTypeNames.Token).Set("repeat" if tiles else "clamp")
    if key == "normal_gl":
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
        texture.CreateInput("bias", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
    return texture

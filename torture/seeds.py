"""Small valid inputs of every reader, made by the project's own writers: {file name: bytes} each."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

Files = dict[str, bytes]

SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/></integrator>
<default name="size" value="16"/><sensor type="perspective"><float name="fov" value="45"/>
<transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="$size"/><integer name="height" value="16"/></film>
<sampler type="independent"><integer name="sample_count" value="4"/></sampler></sensor>
<bsdf type="diffuse" id="wall"><rgb name="reflectance" value="0.5,0.4,0.3"/></bsdf>
<shape type="rectangle"><ref id="wall"/><transform name="to_world"><rotate x="1" angle="-90"/><scale value="2"/>
<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform></shape>
<shape type="sphere"><point name="center" x="0" y="1" z="0"/><float name="radius" value="0.3"/>
<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value="0.2"/></bsdf></shape>
<shape type="rectangle"><emitter type="area"><rgb name="radiance" value="1,2,3"/></emitter></shape></scene>"""


def picture(height: int, width: int, channels: int = 3, seed: int = 0) -> Any:
    """Values in [0.2, 0.9], [height, width, channels] float32, with structure."""
    y, x = np.mgrid[:height, :width]
    noise = np.random.default_rng(seed).random((height, width, channels))
    wave = 0.5 + 0.2 * np.sin(x / 3 + seed) * np.cos(y / 5)
    return (0.8 * wave[..., None] + 0.2 * noise).astype(np.float32)


def image_file(values: Any, suffix: str, depth: str = "uint8") -> bytes:
    """Float values as an image file."""
    import OpenImageIO as oiio

    with tempfile.TemporaryDirectory() as folder:
        name = str(Path(folder) / f"x{suffix}")
        target = oiio.ImageOutput.create(name)
        height, width, channels = values.shape
        if not target.open(name, oiio.ImageSpec(width, height, channels, depth)):
            raise RuntimeError(target.geterror())
        target.write_image(values)
        target.close()
        return Path(name).read_bytes()


def photographs() -> list[Files]:
    """Textures and flash photos, in the formats that cameras and programs write."""
    rgb, alpha = picture(40, 48), picture(34, 34, 4, 1)
    kinds = [(rgb, ".png", "uint8"), (alpha, ".png", "uint16"), (rgb, ".jpg", "uint8"), (rgb, ".tif", "uint8"),
             (alpha, ".tif", "float"), *((rgb, each, "uint8") for each in (".bmp", ".tga", ".gif", ".webp", ".ppm")),
             (rgb, ".exr", "half"), (rgb[..., :1], ".png", "uint8")]  # fmt: skip
    files = [{f"wood{suffix}": image_file(values, suffix, depth)} for values, suffix, depth in kinds]
    return [*files, {"wood.heic": heif_file(rgb)}]


def heif_file(values: Any) -> bytes:
    """A picture as phones write it, of values [height, width, 3] in [0, 1]."""
    import pillow_heif

    written = io.BytesIO()
    pixels = np.ascontiguousarray(255 * values).astype(np.uint8)
    pillow_heif.from_bytes("RGB", pixels.shape[1::-1], pixels.tobytes()).save(written)
    return written.getvalue()


def flash_photos() -> list[Files]:
    """Photographs, under names that say material and split."""
    names = ("train_0231_IMG_0785", "test_x_", "a b;c")
    return [
        {f"{names[i % 3]}{Path(name).suffix}": content for name, content in files.items()}
        for i, files in enumerate(photographs()[:6])
    ]


def maps_of_light() -> list[Files]:
    """Lat-long maps, EXR and Radiance HDR, and a photograph of a sphere."""
    light = picture(32, 64) * 3
    kinds = ((".exr", "half"), (".hdr", "float"), (".exr", "float"), (".tif", "float"))
    files = [{f"sky{suffix}": image_file(light, suffix, depth)} for suffix, depth in kinds]
    return [*files, {"ball.png": image_file(picture(40, 40), ".png")}]


def strips() -> list[Files]:
    """Five tiles side by side; the second holds normals."""
    values = picture(32, 160)
    values[:, 32:64] = (0.5, 0.5, 0.98)
    return [{"7;marbleXwood;1X2.png": image_file(values, ".png")}, {"7.jpg": image_file(values, ".jpg")}]


def material_maps() -> list[Files]:
    """Maps in a folder."""
    normal = np.tile(np.float32((0.5, 0.5, 0.98)), (32, 32, 1))
    colour, gray = picture(32, 32), picture(32, 32, 1)
    return [
        {"rock_diff.png": image_file(colour, ".png"), "rock_normal.png": image_file(normal, ".png"),
         "rock_rough.png": image_file(gray, ".png"), "rock_metal.jpg": image_file(gray, ".jpg")},
        {"rock.tif": image_file(colour, ".tif"), "rock_norm.exr": image_file(normal, ".exr", "half"),
         "rock_gloss.png": image_file(gray, ".png")},
    ]  # fmt: skip


def networks() -> list[Files]:
    """NBRDF networks."""
    from data_tools.readers.nbrdf import SHAPES

    rng, found = np.random.default_rng(0), []
    for prefix, kind in (("", "<f4"), ("gold_", "<f8")):
        files = {}
        for part, shape in SHAPES.items():
            stream = io.BytesIO()
            np.save(stream, (rng.standard_normal(shape) * 0.1).astype(kind))
            files[f"{prefix}{part}.npy"] = stream.getvalue()
        found.append(files)
    return found


def rgl_files() -> list[Files]:
    """A small file of the RGL database: few angles, a coarse grid."""
    from metapp.extensions.rgl.tensor_file import write_tensor_file

    grid, nodes = np.random.default_rng(0).random((1, 3, 4, 4)).astype("f4"), np.float32([0, 0.7, 1.4])
    fields = {"description": np.frombuffer(b"paint", np.uint8), "phi_i": np.zeros(1, "f4"), "theta_i": nodes,
              "sigma": np.ones((2, 2), "f4"), "ndf": np.ones((2, 2), "f4"), "vndf": grid + 1, "luminance": grid + 1,
              "rgb": np.stack([grid] * 3, 2), "jacobian": np.ones(1, np.uint8)}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        write_tensor_file(Path(folder) / "x", fields)
        return [{"paint.bsdf": (Path(folder) / "x").read_bytes()}]


def goniometer_files() -> list[Files]:
    """Tables of a goniometer, in RGB and as spectra."""
    rng = np.random.default_rng(0)
    angles = rng.random((80, 4)) * [89, 360, 89, 360]
    head = "# a comment\ntheta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,"

    def table(names: list[str], unit: float = 1.0) -> bytes:
        values = rng.random((len(angles), len(names)))
        lines = [",".join(f"{each:.5g}" for each in row) for row in np.concatenate([angles * unit, values], 1)]
        return "\n".join((head + ",".join(names), *lines, "")).encode()

    spectral = table([f"{each}nm" for each in range(400, 701, 50)], np.pi / 180).replace(b"_deg", b"_rad")
    return [{"paint.csv": table(["r", "g", "b"])}, {"foil.csv": spectral}]


def scenes_xml() -> list[Files]:
    """Scenes as XML, alone and with an included file."""
    part = '<scene version="3.0.0"><bsdf type="diffuse" id="other"/></scene>'
    including = SCENE.replace("<sensor", '<include filename="part.xml"/><sensor')
    return [{"box.xml": SCENE.encode()}, {"box.xml": including.encode(), "part.xml": part.encode()}]


def scenes_json() -> list[Files]:
    """Scenes as dictionaries, and XML inside JSON."""
    from data_tools.synthetic.cornell import random_scene

    boxes = [json.dumps(random_scene(seed)).encode() for seed in (0, 1)]
    return [*({"box.json": box} for box in boxes), {"box.json": json.dumps({"xml": SCENE}).encode()}]


def shards() -> list[Files]:
    """A data set of two BRDF tasks."""
    from data_tools.readers.brdf_task import UNITS, brdf_task
    from metapp.storage.shards import ShardWriter

    with tempfile.TemporaryDirectory() as folder:
        with ShardWriter(folder, "brdf", UNITS, {"made_by": "torture"}) as writer:
            for index, split in enumerate(("train", "test")):
                task = brdf_task(f"task{index}", lambda angles, i=index: angles * 0 + 0.1 + i, samples=64)
                writer.add(task._replace(data={k: v for k, v in task.data.items() if k in UNITS}), split, "x")
        return [{file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}]


def checkpoints() -> list[Files]:
    """The small trained checkpoints that ship."""
    from metapp.runs.checkpoints.shipped import shipped_path

    names = ("meta-sgd", "meta-curvature")
    return [{f"{name}.safetensors": shipped_path("brdf", name).read_bytes()} for name in names]


def records() -> list[Files]:
    """A run's record file."""
    settings = {"app": "brdf", "steps": 10}
    from metapp.storage.records import digest

    line = {"error": 0.5, "seconds": 0.1, "key": digest(settings), "settings": settings}
    return [{"record.jsonl": b"".join(json.dumps({"name": n, **line}).encode() + b"\n" for n in ("a", "b", "c"))}]

"""Small valid files of every reader, most made by the project's own writers: {file name: content} each."""

import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.pictures import png_with, profile, write_exr
from tests.scene_files import OBJ, ply, serialized, volume

Files = dict[str, bytes]
LIGHT = (".hdr", ".pfm")  # without alpha

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


def picture(height: int, width: int, channels: int = 3) -> Any:
    """Values in [0.2, 0.9], [height, width, channels] float32, with structure."""
    y, x = np.mgrid[:height, :width]
    noise = np.random.default_rng(0).random((height, width, channels))
    return (0.8 * (0.5 + 0.2 * np.sin(x / 3) * np.cos(y / 5))[..., None] + 0.2 * noise).astype(np.float32)


def image(values: Any, suffix: str, depth: str = "uint8") -> bytes:
    import OpenImageIO as oiio

    with tempfile.TemporaryDirectory() as folder:
        name = str(Path(folder) / f"x{suffix}")
        target = oiio.ImageOutput.create(name)
        height, width, channels = values.shape
        assert target.open(name, oiio.ImageSpec(width, height, channels, depth)), target.geterror()
        target.write_image(values)
        target.close()
        return Path(name).read_bytes()


def images(*kinds: str) -> list[Files]:
    """A picture, also a map of light, in each of these formats, "suffix depth"; with alpha where not of 8 bits."""
    return [
        {
            f"wood{suffix}": image(
                picture(32, 64, 3 if depth in ("uint8", "half") or suffix in LIGHT else 4), suffix, depth
            )
        }
        for suffix, depth in map(str.split, kinds)
    ]


def windows() -> list[Files]:
    """Maps of light whose data window is larger than the display window, or a little smaller."""
    wide = picture(40, 72)
    return [
        of_exr((":R G B", wide), window=(32, 64, -4, -4)),
        of_exr((":R G B", wide[:31, :64]), window=(32, 64, 0, 0)),
    ]


def layers() -> list[Files]:
    """Maps of light in layers, and in parts, of an EXR file, beside others."""
    values = picture(32, 64, 8)
    names = (
        "View.Depth.Z",
        "View.AO.R View.AO.G View.AO.B",
        "View.Combined.R View.Combined.G View.Combined.B View.Combined.A",
    )
    parts = ("depth:Z", values[..., :1]), ("AO:R G B", values[..., 1:4]), ("beauty:R G B A", values[..., 4:])
    return [of_exr((f":{' '.join(names)}", values)), of_exr(*parts)]


def deep() -> list[Files]:
    return [of_exr(("deep:R G B A", picture(32, 64, 4)))]


def balls() -> list[Files]:
    """Linear photographs, of more than white."""
    return [{f"ball{suffix}": image(3 * picture(64, 64), suffix, "float")} for suffix in (".exr", ".hdr", ".tif")]


def of_exr(*parts: tuple[str, Any], window: tuple[int, int, int, int] | None = None) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        return {"wood.exr": write_exr(Path(folder) / "x.exr", *parts, window=window).read_bytes()}


def profiles() -> list[Files]:
    """Photographs that state their colours: by profiles, in PNG and EXIF."""
    from PIL import Image

    levels = (picture(32, 64) * 255).astype(np.uint8)
    matrix, gray = np.array([[0.8, 0.1, 0.06], [0.3, 0.65, 0.05], [0, 0.03, 0.8]]), levels[..., 0]
    adobe = Image.Exif()
    adobe.get_ifd(0x8769)[0xA005] = {1: "R03"}
    found = []
    for values, suffix, stated in (
        (levels, ".png", {"icc_profile": profile(matrix, 1.8)}),
        (levels, ".jpg", {"icc_profile": profile(matrix, 1.0)}),
        (gray, ".tif", {"icc_profile": profile(matrix, 1.8, kind=b"GRAY")}),
        (levels, ".jpg", {"exif": adobe}),
    ):
        stream = io.BytesIO()
        Image.fromarray(values).save(stream, Image.registered_extensions()[suffix], **stated)
        found.append({f"wood{suffix}": stream.getvalue()})
    chunks = {
        b"gAMA": (55556).to_bytes(4, "big"),
        b"cHRM": np.array([31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000], ">u4").tobytes(),
    }
    return [*found, {"wood.png": png_with(image(picture(32, 64), ".png"), chunks)},
            {"wood.png": png_with(image(picture(32, 64), ".png"), {b"cICP": bytes((9, 16, 0, 1))})}]  # fmt: skip


def radiance() -> list[Files]:
    """Radiance pictures whose header states exposure and primaries."""
    plain = image(picture(32, 64), ".hdr", "float")
    more = b"\nEXPOSURE=4.0\nCOLORCORR= 1 0.5 1\nPRIMARIES= .7 .3 .2 .7 .15 .05 .3127 .329\n"
    return [{"wood.hdr": plain.replace(b"\n", more, 1)}]


def strips() -> list[Files]:
    values = picture(32, 160)
    values[:, 32:64] = (0.5, 0.5, 0.98)
    return [{"7;marbleXwood;1X2.png": image(values, ".png")}, {"7.jpg": image(values, ".jpg")}]


def maps() -> list[Files]:
    normal, gray = np.tile(np.float32((0.5, 0.5, 0.98)), (32, 32, 1)), picture(32, 32, 1)
    return [
        {"rock_diff.png": image(picture(32, 32), ".png"), "rock_normal.exr": image(normal, ".exr", "half"),
         "rock_rough.png": image(gray, ".png"), "rock_metal.jpg": image(gray, ".jpg")},
        {"rock_diff.PNG": image(picture(32, 32), ".png"), "rock_arm.png": image(picture(32, 32), ".png"),
         "rock_normal.exr": image(normal * 2 - 1, ".exr", "half")},
    ]  # fmt: skip


def merl() -> list[Files]:
    """The header and the first values of a table, whose file is made as long as it says."""
    from data_tools.readers.merl import _HEADER

    return [{"gold.binary": _HEADER.tobytes() + np.linspace(1, 9, 8).tobytes()}]


def networks() -> list[Files]:
    from data_tools.readers.nbrdf_files import NBRDF_ARRAY_SHAPES

    rng, found = np.random.default_rng(0), []
    for prefix, kind in (("", "<f4"), ("gold_", "<f8")):
        files = {}
        for part, shape in NBRDF_ARRAY_SHAPES.items():
            stream = io.BytesIO()
            np.save(stream, (rng.standard_normal(shape) * 0.1).astype(kind))
            files[f"{prefix}{part}.npy"] = stream.getvalue()
        found.append(files)
    return found


def rgl() -> list[Files]:
    from metapp.extensions.rgl.tensor_file import write_tensor_file

    grid, nodes = np.random.default_rng(0).random((1, 3, 4, 4)).astype("f4"), np.float32([0, 0.7, 1.4])
    fields = {"description": np.frombuffer(b"paint", np.uint8), "phi_i": np.zeros(1, "f4"), "theta_i": nodes,
              "sigma": np.ones((2, 2), "f4"), "ndf": np.ones((2, 2), "f4"), "vndf": grid + 1, "luminance": grid + 1,
              "rgb": np.stack([grid] * 3, 2), "jacobian": np.ones(1, np.uint8)}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        write_tensor_file(Path(folder) / "x", fields)
        return [{"paint.bsdf": (Path(folder) / "x").read_bytes()}]


def tables() -> list[Files]:
    rng = np.random.default_rng(0)

    def table(rows: int, unit: str, names: list[str]) -> bytes:
        angles = rng.random((rows, 4)) * [89, 360, 89, 360] * (1 if unit == "deg" else np.pi / 180)
        values = np.concatenate([angles, rng.random((rows, len(names)))], 1)
        head = [f"{name}_{unit}" for name in ("theta_i", "phi_i", "theta_o", "phi_o")]
        lines = ["# a comment", ",".join(head + names), *(",".join(f"{each:.5g}" for each in row) for row in values)]
        return "\n".join((*lines, "")).encode()

    spectrum = [f"{each}nm" for each in range(400, 701, 50)]
    return [{"paint.csv": table(80, "deg", ["r", "g", "b"])}, {"foil.csv": table(60, "rad", spectrum)},
            {"few.csv": table(4, "deg", ["r", "g", "b"])}]  # fmt: skip


def scenes() -> list[Files]:
    from data_tools.synthetic.cornell import random_scene

    part = '<scene version="3.0.0"><bsdf type="diffuse" id="other"/></scene>'
    including = SCENE.replace("<sensor", '<include filename="part.xml"/><sensor')
    old = SCENE.replace('version="3.0.0"', 'version="0.6.0"')
    for new, before in {"max_depth": "maxDepth", "to_world": "toWorld", "sample_count": "sampleCount"}.items():
        old = old.replace(f'"{new}"', f'"{before}"')
    return [{"box.xml": SCENE.encode()}, {"box.xml": including.encode(), "part.xml": part.encode()},
            {"box.xml": old.encode()}, {"box.json": json.dumps(random_scene(0)).encode()}]  # fmt: skip


def meshes() -> list[Files]:
    """A scene with a mesh, or with a grid of values, in a file of its own."""
    from data_tools.synthetic.cornell import random_scene

    grid = np.random.default_rng(0).random((3, 4, 5)) - 0.5
    parts = {"a.ply": ply("binary_little_endian"), "text.ply": ply("ascii"), "a.obj": OBJ.encode(),
             "a.serialized": serialized(), "a.vol": volume((5, 4, 3), values=grid)}  # fmt: skip
    found = []
    for name, content in parts.items():
        kind = "sdfgrid" if name.endswith(".vol") else name.rpartition(".")[2]
        scene = {**random_scene(0), "more": {"type": kind, "filename": name}}
        found.append({name: content, "box.json": json.dumps(scene).encode()})
    return found


def shards() -> list[Files]:
    from data_tools.readers.brdf_task import UNITS, make_brdf_task
    from metapp.storage.shards import write_data_set

    with tempfile.TemporaryDirectory() as folder:
        tasks = [make_brdf_task(f"task{i}", lambda angles, i=i: angles * 0 + 0.1 + i, samples=64) for i in range(2)]
        pairs = zip(tasks, ("train", "test"), "xx", strict=True)
        write_data_set(folder, "brdf", UNITS, pairs, {"made_by": "a test"})
        return [{file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}]


def checkpoints() -> list[Files]:
    from metapp.storage.shipped_checkpoints import shipped_checkpoint_path

    names = ("meta-sgd", "meta-curvature")
    return [{f"{name}.safetensors": shipped_checkpoint_path("brdf", name).read_bytes()} for name in names]


def records() -> list[Files]:
    settings = {"app": "brdf", "steps": 10}
    record = {"name": "a", "error": 0.5, "seconds": 0.1, "source": "/a.csv", "content": "12ab", "settings": settings}
    return [{"record.json": json.dumps(record, indent=1).encode()}]

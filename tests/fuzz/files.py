"""Small valid files for every reader, most made by metapp's writers, each input as {file name: content}."""

import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tests.pictures import add_png_chunks, icc_profile, write_exr
from tests.scene_files import OBJ, ply_file, serialized_file, volume_file

Files = dict[str, bytes]
FORMATS_WITHOUT_ALPHA = (".hdr", ".pfm")

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


def wavy_picture(height: int, width: int, channels: int = 3) -> Any:
    """Return waves with noise, [height, width, channels] float32 in about [0.1, 1]."""
    y, x = np.mgrid[:height, :width]
    noise = np.random.default_rng(0).random((height, width, channels))
    return (0.8 * (0.5 + 0.2 * np.sin(x / 3) * np.cos(y / 5))[..., None] + 0.2 * noise).astype(np.float32)


def encode_image(values: Any, suffix: str, depth: str = "uint8") -> bytes:
    """Return the bytes of an image file of values [height, width, channels]."""
    import OpenImageIO as oiio

    with tempfile.TemporaryDirectory() as folder:
        name = str(Path(folder) / f"x{suffix}")
        target = oiio.ImageOutput.create(name)
        height, width, channels = values.shape
        assert target.open(name, oiio.ImageSpec(width, height, channels, depth)), target.geterror()
        target.write_image(values)
        target.close()
        return Path(name).read_bytes()


def image_files(*kinds: str) -> list[Files]:
    """Return a picture that is also a valid environment map, for each "suffix depth".

    It has an alpha channel unless the depth is uint8 or half or the format has none.
    """
    return [
        {
            f"wood{suffix}": encode_image(
                wavy_picture(32, 64, 3 if depth in ("uint8", "half") or suffix in FORMATS_WITHOUT_ALPHA else 4),
                suffix,
                depth,
            )
        }
        for suffix, depth in map(str.split, kinds)
    ]


def exr_windows() -> list[Files]:
    """Return environment maps whose data window is larger than the display window, or a little smaller."""
    wide = wavy_picture(40, 72)
    return [
        exr_file((":R G B", wide), window=(32, 64, -4, -4)),
        exr_file((":R G B", wide[:31, :64]), window=(32, 64, 0, 0)),
    ]


def exr_layers() -> list[Files]:
    """Return environment maps that are one of several layers, or of several parts, of an EXR file."""
    values = wavy_picture(32, 64, 8)
    names = (
        "View.Depth.Z",
        "View.AO.R View.AO.G View.AO.B",
        "View.Combined.R View.Combined.G View.Combined.B View.Combined.A",
    )
    parts = ("depth:Z", values[..., :1]), ("AO:R G B", values[..., 1:4]), ("beauty:R G B A", values[..., 4:])
    return [exr_file((f":{' '.join(names)}", values)), exr_file(*parts)]


def deep_exr() -> list[Files]:
    """Return a deep EXR file without samples."""
    return [exr_file(("deep:R G B A", wavy_picture(32, 64, 4)))]


def ball_photos() -> list[Files]:
    """Return linear photographs with values up to 3, so also above white."""
    return [
        {f"ball{suffix}": encode_image(3 * wavy_picture(64, 64), suffix, "float")}
        for suffix in (".exr", ".hdr", ".tif")
    ]


def exr_file(*parts: tuple[str, Any], window: tuple[int, int, int, int] | None = None) -> Files:
    """Return an EXR file of parts and a window, which `tests.pictures.write_exr` explains."""
    with tempfile.TemporaryDirectory() as folder:
        return {"wood.exr": write_exr(Path(folder) / "x.exr", *parts, window=window).read_bytes()}


def photos_with_stated_colours() -> list[Files]:
    """Return photographs that state their colour space: by ICC profiles, by PNG chunks and in EXIF."""
    from PIL import Image

    levels = (wavy_picture(32, 64) * 255).astype(np.uint8)
    matrix, gray = np.array([[0.8, 0.1, 0.06], [0.3, 0.65, 0.05], [0, 0.03, 0.8]]), levels[..., 0]
    adobe = Image.Exif()
    adobe.get_ifd(0x8769)[0xA005] = {1: "R03"}
    files: list[Files] = []
    for values, suffix, colour_options in (
        (levels, ".png", {"icc_profile": icc_profile(matrix, 1.8)}),
        (levels, ".jpg", {"icc_profile": icc_profile(matrix, 1.0)}),
        (gray, ".tif", {"icc_profile": icc_profile(matrix, 1.8, kind=b"GRAY")}),
        (levels, ".jpg", {"exif": adobe}),
    ):
        stream = io.BytesIO()
        Image.fromarray(values).save(stream, Image.registered_extensions()[suffix], **colour_options)
        files.append({f"wood{suffix}": stream.getvalue()})
    chunks = {
        b"gAMA": (55556).to_bytes(4, "big"),
        b"cHRM": np.array([31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000], ">u4").tobytes(),
    }
    plain = encode_image(wavy_picture(32, 64), ".png")
    code_points = {b"cICP": bytes((9, 16, 0, 1))}
    files += [{"wood.png": add_png_chunks(plain, added)} for added in (chunks, code_points)]
    return files


def radiance_pictures() -> list[Files]:
    """Return a Radiance picture whose header states exposure, colour correction and primaries."""
    plain = encode_image(wavy_picture(32, 64), ".hdr", "float")
    added_lines = b"\nEXPOSURE=4.0\nCOLORCORR= 1 0.5 1\nPRIMARIES= .7 .3 .2 .7 .15 .05 .3127 .329\n"
    return [{"wood.hdr": plain.replace(b"\n", added_lines, 1)}]


def component_strips() -> list[Files]:
    """Return strips of five squares, a photograph and four maps side by side, as PNG and JPEG."""
    values = wavy_picture(32, 160)
    values[:, 32:64] = (0.5, 0.5, 0.98)
    return [{"7;marbleXwood;1X2.png": encode_image(values, ".png")}, {"7.jpg": encode_image(values, ".jpg")}]


def material_maps() -> list[Files]:
    """Return materials as separate maps, with single and with packed channels."""
    normal, gray = np.tile(np.float32((0.5, 0.5, 0.98)), (32, 32, 1)), wavy_picture(32, 32, 1)
    colours = encode_image(wavy_picture(32, 32), ".png")
    return [
        {"rock_diff.png": colours, "rock_normal.exr": encode_image(normal, ".exr", "half"),
         "rock_rough.png": encode_image(gray, ".png"), "rock_metal.jpg": encode_image(gray, ".jpg")},
        {"rock_diff.PNG": colours, "rock_arm.png": colours,
         "rock_normal.exr": encode_image(normal * 2 - 1, ".exr", "half")},
    ]  # fmt: skip


def merl_tables() -> list[Files]:
    """Return the header and the first values of a MERL table; the test makes the file as long as the header says."""
    from data_tools.readers.merl import _HEADER

    return [{"gold.binary": _HEADER.tobytes() + np.linspace(1, 9, 8).tobytes()}]


def nbrdf_networks() -> list[Files]:
    """Return random NBRDF networks as arrays, with and without a prefix in front of their names."""
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


def rgl_tables() -> list[Files]:
    """Return an isotropic RGL table of random values."""
    from metapp.extensions.rgl.tensor_file import write_tensor_file

    grid, nodes = np.random.default_rng(0).random((1, 3, 4, 4)).astype("f4"), np.float32([0, 0.7, 1.4])
    fields = {"description": np.frombuffer(b"paint", np.uint8), "phi_i": np.zeros(1, "f4"), "theta_i": nodes,
              "sigma": np.ones((2, 2), "f4"), "ndf": np.ones((2, 2), "f4"), "vndf": grid + 1, "luminance": grid + 1,
              "rgb": np.stack([grid] * 3, 2), "jacobian": np.ones(1, np.uint8)}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        write_tensor_file(Path(folder) / "x", fields)
        return [{"paint.bsdf": (Path(folder) / "x").read_bytes()}]


def goniometer_tables() -> list[Files]:
    """Return goniometer tables in degrees and rad, with colours and with spectra, one of them of four rows."""
    rng = np.random.default_rng(0)

    def table_text(rows: int, unit: str, names: list[str]) -> bytes:
        angles = rng.random((rows, 4)) * [89, 360, 89, 360] * (1 if unit == "deg" else np.pi / 180)
        values = np.concatenate([angles, rng.random((rows, len(names)))], 1)
        head = [f"{name}_{unit}" for name in ("theta_i", "phi_i", "theta_o", "phi_o")]
        lines = ["# a comment", ",".join(head + names), *(",".join(f"{value:.5g}" for value in row) for row in values)]
        return "\n".join((*lines, "")).encode()

    spectrum = [f"{wavelength}nm" for wavelength in range(400, 701, 50)]
    return [{"paint.csv": table_text(80, "deg", ["r", "g", "b"])}, {"foil.csv": table_text(60, "rad", spectrum)},
            {"few.csv": table_text(4, "deg", ["r", "g", "b"])}]  # fmt: skip


def scene_files() -> list[Files]:
    """Return Mitsuba scenes: XML, XML with an include, XML of version 0.6 and JSON."""
    from data_tools.synthetic.cornell import random_scene

    part = '<scene version="3.0.0"><bsdf type="diffuse" id="other"/></scene>'
    including = SCENE.replace("<sensor", '<include filename="part.xml"/><sensor')
    old = SCENE.replace('version="3.0.0"', 'version="0.6.0"')
    for new, before in {"max_depth": "maxDepth", "to_world": "toWorld", "sample_count": "sampleCount"}.items():
        old = old.replace(f'"{new}"', f'"{before}"')
    return [{"box.xml": SCENE.encode()}, {"box.xml": including.encode(), "part.xml": part.encode()},
            {"box.xml": old.encode()}, {"box.json": json.dumps(random_scene(0)).encode()}]  # fmt: skip


def scenes_with_data_files() -> list[Files]:
    """Return scenes that name a data file beside them: a mesh or a grid of values."""
    from data_tools.synthetic.cornell import random_scene

    grid = np.random.default_rng(0).random((3, 4, 5)) - 0.5
    parts = {"a.ply": ply_file("binary_little_endian"), "text.ply": ply_file("ascii"), "a.obj": OBJ.encode(),
             "a.serialized": serialized_file(), "a.vol": volume_file((5, 4, 3), values=grid)}  # fmt: skip
    found = []
    for name, content in parts.items():
        kind = "sdfgrid" if name.endswith(".vol") else name.rpartition(".")[2]
        scene = {**random_scene(0), "more": {"type": kind, "filename": name}}
        found.append({name: content, "box.json": json.dumps(scene).encode()})
    return found


def data_sets() -> list[Files]:
    """Return a data set of two BRDF tasks."""
    from data_tools.readers.brdf_task import UNITS, make_brdf_task
    from metapp.storage.shards import write_data_set

    with tempfile.TemporaryDirectory() as folder:
        tasks = [make_brdf_task(f"task{i}", lambda angles, i=i: angles * 0 + 0.1 + i, samples=64) for i in range(2)]
        pairs = zip(tasks, ("train", "test"), "xx", strict=True)
        write_data_set(folder, "brdf", UNITS, pairs, {"made_by": "a test"})
        return [{file.name: file.read_bytes() for file in sorted(Path(folder).iterdir())}]


def checkpoints() -> list[Files]:
    """Return two checkpoints that ship, the second of several entries."""
    from metapp.storage.shipped_checkpoints import shipped_checkpoint_path

    recipes = ("paper", "quick")
    return [{f"{recipe}.safetensors": shipped_checkpoint_path("brdf", recipe).read_bytes()} for recipe in recipes]


def records() -> list[Files]:
    """Return records of a fit: as earlier versions wrote it, and as it is written now."""
    settings = {"app": "brdf", "steps": 10}
    record = {"name": "a", "error": 0.5, "seconds": 0.1, "source": "/a.csv", "content": "12ab", "settings": settings}
    parts = {"scale": 100.0, "errors": {"map": 0.2}, "figures": {"albedo": [0.1, 0.2, 0.3]}, "counts": {"photos": 2}}
    parts |= {"origin": {"inputs": ["/a.csv"]}}
    return [{"record.json": json.dumps(document, indent=1).encode()} for document in (record, record | parts)]

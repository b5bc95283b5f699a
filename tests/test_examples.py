"""The scripts in examples/ run."""

import ast
import json
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

import metapp
from tests import forks
from tests.needs_mitsuba import needs_mitsuba
from tests.pictures import write_image, write_planes

pytestmark = pytest.mark.usefixtures("compiled_in_cache")

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., str]:
    """Return a function that runs an example in a fork that has imported torch alone, and returns what it prints."""

    def call(script: str | Path, *arguments: str | Path) -> str:
        code, messages, warned = forks.run_script(EXAMPLES / script, *arguments, output_folder=tmp_path / "said")
        assert code == 0, warned
        assert warned == ""
        return messages

    return call


@pytest.fixture
def run_here(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Return a function that runs an example in this process, which has imported torch already."""

    def call(script: str, *arguments: str | Path) -> str:
        monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
        capfd.readouterr()
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")
        messages, warned = capfd.readouterr()
        assert warned == ""
        return messages

    return call


@pytest.mark.long
def test_example_brdf_to_onnx_computes_what_the_fit_does(
    write_nbrdf_networks: Callable[[int], Path], tmp_path: Path, run_here: Callable[..., str]
) -> None:
    pytest.importorskip("onnxscript")
    runtime = pytest.importorskip("onnxruntime")
    material, model = next(write_nbrdf_networks(1).iterdir()), tmp_path / "paint.onnx"
    assert str(model) in run_here("brdf_to_onnx.py", material, model)
    wi, wo = (torch.nn.functional.normalize(torch.rand(50, 3) + 0.1, dim=1) for _ in range(2))
    session = runtime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    (found,) = session.run(["reflectance"], {"wi": wi.numpy(), "wo": wo.numpy()})
    np.testing.assert_allclose(found, metapp.fit("brdf", material)(wi, wo).numpy(), rtol=1e-3, atol=1e-4)


def test_example_fit_brdf_runs(
    write_nbrdf_networks: Callable[[int], Path], tmp_path: Path, run: Callable[..., str]
) -> None:
    output = run("fit_brdf.py", next(write_nbrdf_networks(1).iterdir()), tmp_path / "a.safetensors")
    assert output.startswith("error x100 ")
    assert output.count("1/sr") == 3
    assert output.splitlines()[-1].endswith("21471 weights")
    assert (tmp_path / "a.safetensors").is_file()


def test_maml_by_torch_and_by_metapp_prints_equal_losses(run: Callable[..., str]) -> None:
    """Fifty outer steps of both loops give the same weights and rates, which fit unseen sinusoids better."""
    first, last = run("maml.py", "50").splitlines()
    assert run("maml_with_metapp.py", "50").splitlines() == [first, last]
    assert (first.split(",")[0], last.split(",")[0]) == ("outer step    0", "outer step   50")
    (before, after), (_, learned_after) = (map(float, re.findall(r"\d\.\d{5}", line)) for line in (first, last))
    assert 0.8 * before < after < before
    assert learned_after < 0.7 * after


def test_maml_by_torch_has_thirty_lines_and_hides_nothing_in_imports() -> None:
    text = (EXAMPLES / "maml.py").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.strip() and not line.strip().startswith("#")]
    assert len(lines) <= 30
    assert [line for line in lines if "import" in line] == ["import sys", "import torch"]


def test_page_about_maml_quotes_lines_of_both_examples() -> None:
    page = (EXAMPLES.parent / "docs" / "concepts.md").read_text(encoding="utf-8")
    section = page.split("\n## MAML in two files\n")[1].split("\n## ")[0]
    rows = [line.split("|")[2:4] for line in section.splitlines() if line.startswith("|")][2:]
    assert len(rows) > 9
    for column, script in enumerate(("maml.py", "maml_with_metapp.py")):
        text = (EXAMPLES / script).read_text(encoding="utf-8")
        for row in rows:
            assert all(code in text for code in re.findall(r"`([^`]+)`", row[column])), row


@pytest.mark.long
def test_example_compare_paradigms_runs(
    write_nbrdf_networks: Callable[[int], Path], run_here: Callable[..., str]
) -> None:
    rows = [
        line.split()
        for line in run_here("compare_paradigms.py", next(write_nbrdf_networks(1).iterdir())).splitlines()[1:]
    ]
    assert [row[0] for row in rows] == ["general", "quickft", "meta", "finetune", "overfit"]
    error = {name: float(value) for name, value, _ in rows}
    assert max(error["finetune"], error["overfit"]) < error["meta"] < error["general"]


def pixels(path: Path) -> np.ndarray:
    values: np.ndarray = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
    return values


def write_maps(folder: Path, prefix: str = "", **colours: tuple[float, ...]) -> Path:
    """Maps of 16 x 16 texels, of one colour each."""
    for name, colour in colours.items():
        write_planes(folder / f"{prefix}{name}.png", torch.tensor(colour)[:, None, None].expand(-1, 16, 16))
    return folder


def smaller(script: str, changes: dict[str, str], folder: Path) -> Path:
    """An example that draws a small picture: expressions found in it once, and what stands there instead."""
    text = (EXAMPLES / script).read_text(encoding="utf-8")
    for found, instead in changes.items():
        text, count = re.subn(found, instead, text)
        assert count == 1, found
    (folder / script).write_text(text, encoding="utf-8")
    return folder / script


@pytest.mark.long
@needs_mitsuba
def test_example_mitsuba_brdf_runs(
    write_nbrdf_networks: Callable[[int], Path], tmp_path: Path, run: Callable[..., str]
) -> None:
    changes = {r'"width": 512, "height": 512': '"width": 48, "height": 48', r"spp=64": "spp=8"}
    script = smaller("mitsuba_brdf.py", changes, tmp_path)
    output = run(script, next(write_nbrdf_networks(1).iterdir()), tmp_path / "ball.png")
    assert output.startswith("m0: error x100 ")
    picture = pixels(tmp_path / "ball.png")
    assert picture.shape[:2] == (48, 48)
    assert picture[24, 24, :3].max() > 0.02


@pytest.mark.long
@needs_mitsuba
def test_example_anisotropic_brdf_runs(tmp_path: Path, run: Callable[..., str]) -> None:
    """The fit is nearer to the metal than that which knows no azimuth."""
    changes = {r"SIZE, SAMPLES = .*": "SIZE, SAMPLES = 32, 16", r', "Al": .*': "}"}
    output = run(smaller("anisotropic_brdf.py", changes, tmp_path), tmp_path / "a.png")
    found = re.findall(r"error x100 ([\d.]+), picture differs by ([\d.]+) %", output)
    (error, off), (other_error, other_off) = ((float(number) for number in pair) for pair in found)
    assert error < 0.2 * other_error
    assert off < 0.3 * other_off
    assert pixels(tmp_path / "a.png").shape[:2] == (32, 96)


@needs_mitsuba
def test_example_guided_render_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Callable[..., str]) -> None:
    monkeypatch.setenv("PYTHONWARNINGS", "ignore")  # in a small picture of one ball a guide does not pay
    scene = """<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
        <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/></film></sensor>
      <shape type="sphere"><bsdf type="diffuse"/></shape>
      <emitter type="constant"/>
    </scene>"""
    (tmp_path / "ball.xml").write_text(scene, encoding="utf-8")
    assert run("guided_render.py", tmp_path / "ball.xml", tmp_path / "ball.png") == f"saved {tmp_path / 'ball.png'}\n"
    assert pixels(tmp_path / "ball.png").shape[:2] == (16, 24)


@pytest.mark.long
def test_example_photo_to_blender_runs(tmp_path: Path, run_here: Callable[..., str]) -> None:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    wall = np.stack([np.exp(-2 * (x * x + y * y)) * (0.5 + 0.3 * np.sin(9 * x + i)) for i in range(3)], -1)
    photo = write_image(tmp_path / "wall.png", wall.astype(np.float32), "uint8")
    output = run_here("photo_to_blender.py", photo, tmp_path / "out")
    assert output.startswith("wall: 256 x 256 texels")
    assert (tmp_path / "out" / "gltf" / "wall.glb").read_bytes().startswith(b"glTF")
    assert len(list((tmp_path / "out" / "asset" / "wall").iterdir())) == 12
    assert len(list((tmp_path / "out" / "blender" / "wall").iterdir())) == 8


@needs_mitsuba
def test_example_mitsuba_scene_runs(
    write_nbrdf_networks: Callable[[int], Path], tmp_path: Path, run: Callable[..., str]
) -> None:
    """The picture has few pixels: white light from everywhere shows a floor in its colour, and balls on it."""
    red = {"diffuse": (0.8, 0.2, 0.2), "specular": (0.0, 0.0, 0.0), "normal_gl": (0.5, 0.5, 1.0), "roughness": (0.9,)}
    maps, network = write_maps(tmp_path / "clay", "clay_", **red), next(write_nbrdf_networks(1).iterdir())
    light = write_image(tmp_path / "light.exr", np.ones((8, 16, 3), np.float32))
    changes = {r"SIZE, SAMPLES, EXPOSURE = .*": "SIZE, SAMPLES, EXPOSURE = 48, 8, 0.3"}
    output = run(smaller("mitsuba_scene.py", changes, tmp_path), maps, light, tmp_path / "a.png", network, network)
    assert "48 x 48 px, 8 samples" in output
    picture = pixels(tmp_path / "a.png")
    assert picture.shape[:2] == (48, 48)
    floor, ball = picture[44, 24, :3], picture[20, 24, :3]
    assert floor[0] > 1.5 * floor[1]
    assert abs(ball - floor).max() > 0.1


@needs_mitsuba
@pytest.mark.slow
def test_example_ball_to_hdr_runs(tmp_path: Path, run: Callable[..., str]) -> None:
    y, x = np.mgrid[-1:1:64j, -1:1:64j]
    shade = np.where(x * x + y * y < 1, 0.4 - 0.3 * y, 0)[..., None].repeat(3, 2)  # lit from above
    ball = write_image(tmp_path / "ball.png", shade.astype(np.float32), "uint8")
    output = run("ball_to_hdr.py", ball, tmp_path / "map.exr")
    assert output.startswith("ball: 256 x 128 texels, fitted in ")
    result = pixels(tmp_path / "map.exr")
    assert result.shape == (128, 256, 3)
    assert result[:64].mean() > result[64:].mean() > 0


@pytest.mark.long
@pytest.mark.usefixtures("vgg_weights", "second_scene")
def test_example_notebook_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Its cells run in order, and cells that end with a fit show it; the texture has 64 texels instead of 256."""
    document = json.loads((EXAMPLES / "notebook.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in document["cells"] if cell["cell_type"] == "code"]
    assert not any(cell.get("outputs") for cell in document["cells"])
    monkeypatch.chdir(tmp_path)
    shown, names = [], dict[str, object]()
    for number, cell in enumerate(cells):
        tree = ast.parse(cell.replace("bricks)\n", 'bricks, recipe="quick")\n'))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else ast.parse("0").body[0]
        exec(compile(tree, f"cell {number}", "exec"), names)
        value = eval(ast.unparse(last), names)
        shown += [value._repr_html_()] if hasattr(value, "_repr_html_") else []
    assert [html.count("<img") for html in shown] == [1, 1, 1]
    assert {path.name for path in tmp_path.iterdir()} == {"bricks.png", "plastic.safetensors"}
    assert names["wall"].app.name == "texture"
    assert names["light"].error < 1
    messages, warned = capfd.readouterr()
    assert messages.startswith("{'basecolor': (256, 256, 3)}")
    assert warned == ""

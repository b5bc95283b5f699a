"""The web page that predicts maps of photos in a browser: with a stub of the runtime, and with the real one."""

import io
import tarfile
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from PIL import Image

from data_tools.readers.square_photos import read_photo
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.onnx_files import onnx_page as pages
from metapp.extensions.onnx_files.onnx_page import write_page_folder
from tests.browser import open_browser

SIDE = 16
# gives the photo, halved, as every map, and fails for one whose first value is 0
STUB = """
const of = (photo) => ({ data: photo.data.map((value) => value / 2) });
var ort = {
  env: { wasm: {} },
  Tensor: class { constructor(type, data, dims) { Object.assign(this, { type, data, dims }); } },
  InferenceSession: { create: async (model) => {
    const { default: named } = await import(ort.env.wasm.wasmPaths.mjs);
    const bytes = new Uint8Array(ort.env.wasm.wasmBinary);
    if (named + bytes + model !== "module1,2,34,5") throw new Error(named + bytes + model);
    return { run: async ({ photo }) => {
      if (photo.data[0] === 0) throw new Error("too dark");
      const grey = { data: of(photo).data.subarray(0, photo.data.length / 3) };
      return { diffuse: of(photo), specular: of(photo), roughness: grey, normal: of(photo) };
    } };
  } },
};
"""
PARTS = {"script": STUB.encode(), "module": b'export default "module";', "wasm": bytes([1, 2, 3])}
MODEL = bytes([4, 5])


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with open_browser() as opened:
        yield opened


def photo(path: Path, width: int, height: int, seed: int = 0) -> NDArray[np.uint8]:
    """A random picture [height, width, 3], written losslessly."""
    pixels = np.random.default_rng(seed).integers(1, 256, (height, width, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    return pixels


class Opened:
    """The page of a folder, from disk, where nothing is asked of a network."""

    def __init__(self, browser: Any, folder: Path) -> None:
        self.page, self.asked = browser.new_page(), list[str]()
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto((folder.resolve() / "index.html").as_uri())

    def says(self, words: str, seconds: int = 60) -> None:
        """Wait for words in its status line."""
        expected = "words => document.getElementById('said').textContent.includes(words)"
        self.page.wait_for_function(expected, arg=words, timeout=1000 * seconds)
        assert not [url for url in self.asked if not url.startswith(("file:", "data:", "blob:"))]

    def choose(self, path: Path) -> None:
        self.page.set_input_files("#file", path)

    def maps(self) -> dict[str, NDArray[np.float32]]:
        """What the model gave, [C, side, side]."""
        side = self.page.evaluate("maps.side")
        found = self.page.evaluate("Object.entries(maps.values).map(([name, values]) => [name, Array.from(values)])")
        return {name: np.float32(values).reshape(-1, side, side) for name, values in found}


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Opened]:
    write_page_folder(tmp_path / "page", MODEL, PARTS, [SIDE, 2 * SIDE], features=True)
    page = Opened(browser, tmp_path / "page")
    yield page
    page.page.close()


def test_maps_are_shown_and_saved(opened: Opened, tmp_path: Path) -> None:
    """Bytes, values and pixels come through; of a larger photo its central square, averaged in linear light."""
    pixels = photo(tmp_path / "wood.1.png", SIDE, SIDE)
    opened.says("Ready.")
    assert opened.page.is_disabled("#all")
    opened.choose(tmp_path / "wood.1.png")
    opened.says(f"wood.1.png: maps of {SIDE} x {SIDE} px in")
    given = pixels.transpose(2, 0, 1) / 255
    np.testing.assert_allclose(opened.maps()["diffuse"], given / 2, atol=1e-6)
    shown = {
        "diffuse": linear_to_srgb(torch.from_numpy(given / 2)).numpy(),
        "roughness": given[[0] * 3] / 2,
        "normal": given / 4 + 0.5,
    }
    for name, expected in shown.items():
        with opened.page.expect_download() as waiting:
            opened.page.click(f"[data-map={name}]")
        assert waiting.value.suggested_filename == f"wood.1_{name}.png"
        saved = np.asarray(Image.open(waiting.value.path()).convert("RGB"), dtype=float).transpose(2, 0, 1)
        assert abs(saved - 255 * expected).max() < 0.51
    large = photo(tmp_path / "large.png", 3 * SIDE + 10, 2 * SIDE + SIDE // 2)
    opened.choose(tmp_path / "large.png")
    opened.says("large.png: maps")
    assert large.shape[0] % SIDE
    expected = read_photo(tmp_path / "large.png", SIDE).numpy() / 255
    np.testing.assert_allclose(2 * opened.maps()["diffuse"], expected, atol=0.6 / 255)
    opened.page.select_option("#side", str(2 * SIDE))
    opened.says(f"maps of {2 * SIDE}")
    assert opened.maps()["normal"].shape == (3, 2 * SIDE, 2 * SIDE)


def test_problems_are_said_and_the_next_photo_works(opened: Opened, tmp_path: Path, browser: Any) -> None:
    (tmp_path / "notes.txt").write_text("no picture")
    opened.choose(tmp_path / "notes.txt")
    opened.says("notes.txt: no picture that this browser reads")
    Image.new("RGB", (SIDE, SIDE)).save(tmp_path / "dark.png")
    opened.choose(tmp_path / "dark.png")
    opened.says("dark.png: too dark")
    photo(tmp_path / "wood.png", SIDE, SIDE)
    opened.choose(tmp_path / "wood.png")
    opened.says("wood.png: maps")
    (tmp_path / "page" / "model.js").unlink()
    Opened(browser, tmp_path / "page").says("model.js is missing or damaged, expected all three")


def test_licences_are_on_the_page(tmp_path: Path) -> None:
    for features in (False, True):
        write_page_folder(tmp_path, MODEL, PARTS, [SIDE], features=features)
        text = (tmp_path / "index.html").read_text()
        assert ("CC BY 4.0" in text) == features
        assert "Copyright" in text.title()
        assert "copyright Microsoft Corporation, MIT licence" in text
        assert "http" not in text.replace("http-equiv", "")  # nothing is loaded from elsewhere


def archive(parts: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as file:
        for name, content in parts.items():
            member = tarfile.TarInfo(pages.RUNTIME_PARTS[name])
            member.size = len(content)
            file.addfile(member, io.BytesIO(content))
    return buffer.getvalue()


def test_the_runtime_is_fetched_once_and_compared(cache: Path, tmp_path: Path) -> None:
    content, url = archive(PARTS), (tmp_path / "npm.tgz").as_uri()
    ours = {"url": url, "sha512": pages.npm_digest(content)}
    line = r"expected onnxruntime-web .* \(33 MB\), once; get it elsewhere and put it at .*\.tgz\.$"
    with pytest.raises(ValueError, match=line):
        pages.provide_runtime(lambda *_: None, url=url)
    (tmp_path / "npm.tgz").write_bytes(content)
    with pytest.raises(ValueError, match=r"SHA-512 .*\.\.\., expected q0y\+Jrrtuk.*; damaged or another file\.$"):
        pages.provide_runtime(lambda *_: None, url=url)
    assert not list(cache.iterdir())
    shown: list[tuple[int, int | None]] = []
    assert pages.provide_runtime(lambda *state: shown.append(state), **ours) == PARTS
    assert shown[-1] == (len(content), len(content))
    (tmp_path / "npm.tgz").unlink()
    assert pages.provide_runtime(lambda *_: None, **ours) == PARTS
    (cache / pages.RUNTIME_ARCHIVE).write_bytes(content[:-1])  # damaged: asked for anew
    with pytest.raises(ValueError, match=line):
        pages.provide_runtime(lambda *_: None, **ours)


def test_the_command_refuses_before_it_computes(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("onnxscript")
    Path("page").mkdir()
    Path("page/index.html").touch()
    words = ("export", "svbrdf_nonstationary", "onnx-page")
    assert "page/index.html: is there already" in metapp(*words, "--out", "page").misuse

    def refuse(*_: object, **__: object) -> None:
        raise OSError("no route")

    monkeypatch.setattr(urllib.request, "urlopen", refuse)
    assert "expected onnxruntime-web" in metapp(*words).refusal
    assert not Path("onnx-page").exists()

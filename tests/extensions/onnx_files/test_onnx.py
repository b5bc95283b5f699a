"""ONNX models of fits: onnxruntime computes what Python does."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from metapp.apps.brdf.brdf_network import BrdfNetwork
from metapp.apps.brdf.feature_network import Featured
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.extensions.onnx_files import brdf_model, models, photographs
from metapp.learning.task import Params
from metapp.runs.resolve import complete
from metapp.runs.spec import Spec
from metapp.storage.shipped_checkpoints import shipped_checkpoint_path
from tests.marked import long
from tests.recipe_apps import recipes_of

pytest.importorskip("onnxscript")
ort = pytest.importorskip("onnxruntime")
APP = recipes_of("brdf")["quick"].app
NETWORKS = {"nbrdf": NBRDF_NETWORK, "featured": Featured(), "anisotropic": Featured(anisotropic=True)}


def session(path: Path) -> Any:
    return ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])


def theta_of(network: BrdfNetwork) -> Params:
    theta = {key: value[0] for key, value in network.init(Generator().manual_seed(1), 1).items()}
    if "last" in theta:
        theta["last"] = 0.1 * torch.randn(theta["last"].shape, generator=Generator().manual_seed(2))
    return theta


@pytest.mark.parametrize("name", ["nbrdf", long("featured"), long("anisotropic")])
def test_onnx_reflectance_agrees_with_the_fit(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    theta = theta_of(NETWORKS[name])
    brdf_model.write_onnx(APP, theta, tmp_path / "paint")
    assert capfd.readouterr() == ("", "")
    wi, wo = (normalize(torch.randn(5000, 3, generator=Generator().manual_seed(seed)), dim=1) for seed in (3, 4))
    wo[:, 2] = wo[:, 2].abs()
    (found,) = session(tmp_path / "paint.onnx").run(["reflectance"], {"wi": wi.numpy(), "wo": wo.numpy()})
    with torch.no_grad():
        exact = brdf_model.ReflectanceModule(theta)(wi, wo).numpy()
    assert not found[wi[:, 2] < 0].any()
    np.testing.assert_allclose(found, exact, rtol=1e-3, atol=1e-3 * exact.mean())
    assert exact.max() > 0


@pytest.mark.parametrize(("largest", "bits", "apart"), [(1 << 21, 16, 5e-4), (1 << 10, 8, 5e-3)])
def test_large_weights_take_16_or_8_bits(largest: int, bits: int, apart: float, tmp_path: Path) -> None:
    """Outputs of other scales, one of them of zeros, are as exact."""
    layer = torch.nn.Conv2d(64, 32, 3, bias=False)
    with torch.no_grad():
        layer.weight.mul_(torch.logspace(-3, 3, 32)[:, None, None, None])
        layer.weight[7] = 0
    x = torch.rand(1, 64, 8, 8, generator=Generator().manual_seed(1))
    content = models.encode_model(layer, {"x": x}, ["y"], {}, {}, half=True, largest=largest)
    (tmp_path / "layer.onnx").write_bytes(content)
    assert (tmp_path / "layer.onnx").stat().st_size == pytest.approx(layer.weight.numel() * bits / 8, rel=0.1)
    (found,) = session(tmp_path / "layer.onnx").run(["y"], {"x": x.numpy()})
    exact = layer(x).detach()
    scale = exact.abs().mean((0, 2, 3), keepdim=True).clamp_min(1e-9)
    assert ((torch.from_numpy(found) - exact) / scale).abs().mean() < apart


@pytest.mark.long
def test_onnx_maps_agree_with_general(tmp_path: Path, metapp: Callable) -> None:
    """The one that ships, on random pixels, up to weights in half precision; the command says what it takes."""
    result = metapp("export", "svbrdf_nonstationary", "onnx", "--json")
    assert result.json_document == {"form": "onnx", "out": "onnx", "tasks": ["svbrdf_nonstationary"]}
    assert re.search(r"onnx: [34]\.\d MB of ONNX, opset 18, takes photos of 256 x 256 px", result.err)
    photo = torch.rand(1, 3, 256, 256, generator=Generator().manual_seed(5)) ** 2
    found = session(Path("onnx/svbrdf_nonstationary.onnx")).run(
        list(photographs.MODEL_OUTPUTS), {"photo": photo.numpy()}
    )
    exact = _maps(photo)
    for name, values, expected in zip(photographs.MODEL_OUTPUTS, found, exact, strict=True):
        assert np.abs(values - expected.numpy()).mean() < 1e-3, name


def _maps(photo: Tensor) -> tuple[Tensor, ...]:
    from metapp.runs.fitting import Fitter

    spec = complete(Spec(app="svbrdf_nonstationary", paradigm="general", recipe="full", observe="photo", device="cpu"))
    fitter = Fitter.of(spec)
    with torch.no_grad():
        result: tuple[Tensor, ...] = photographs.MaterialModule(fitter.app, fitter.phi.encoder)(photo)
    return result


def test_fits_that_cannot_be_written_are_refused_in_one_line(metapp: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    general = shipped_checkpoint_path("svbrdf_nonstationary", "pretrained")
    assert "a checkpoint of General of photos, or the name of one that" in metapp("export", "texture", "onnx").error
    assert "General of several photos" in metapp("export", "svbrdf_nonstationary/several", "onnx").error
    assert "--recipe 'none'" in metapp("export", "svbrdf_nonstationary/none", "onnx").misuse
    other = shipped_checkpoint_path("texture")
    assert (
        "a checkpoint of texture general, meta-basis, quickft, expected svbrdf_nonstationary general"
        in metapp("export", other, "onnx").error
    )
    for name in ("pretrained", "svbrdf_nonstationary-pretrained"):
        Path(f"{name}.onnx").touch()
    for path in (general, "svbrdf_nonstationary/pretrained"):
        assert ".onnx: is there already" in metapp("export", path, "onnx", "--out", ".").misuse
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install" in metapp("export", "svbrdf_nonstationary", "onnx").error

"""NBRDF networks as arrays and as Keras models: they are found, read and written unchanged, or refused."""

import importlib.util
import io
import math
import os
import pickle
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers.nbrdf_files import (
    NBRDF_ARRAY_SHAPES,
    evaluate_nbrdf,
    find,
    read_nbrdf,
    read_task,
    recognises,
    write_nbrdf,
)
from tests.found_paths import find_paths


def make_weights(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {part: rng.normal(0, 0.5, shape).astype(np.float32) for part, shape in NBRDF_ARRAY_SHAPES.items()}


def make_network(folder: Path, prefix: str = "", seed: int = 0) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for part, array in make_weights(seed).items():
        np.save(folder / f"{prefix}{part}.npy", array)
    return folder


@pytest.mark.parametrize("kind", ["transposed", "big-endian", "double", "tensor"])
def test_files_are_c_ordered_little_endian_float32_and_read_back(tmp_path: Path, kind: str) -> None:
    plain = make_weights()
    change = {
        "transposed": lambda array: np.asfortranarray(array.T.copy().T),
        "big-endian": lambda array: array.astype(">f4"),
        "double": lambda array: array.astype(np.float64),
        "tensor": lambda array: torch.from_numpy(array.T.copy()).T.requires_grad_(),
    }[kind]
    write_nbrdf(tmp_path, {part: change(array) if array.ndim == 2 else array for part, array in plain.items()})
    read = read_nbrdf(tmp_path)
    assert list(read) == list(NBRDF_ARRAY_SHAPES)
    for part, array in plain.items():
        np.testing.assert_array_equal(read[part], array)
        content = (tmp_path / f"{part}.npy").read_bytes()
        assert content[:8] == b"\x93NUMPY\x01\x00"
        length = int.from_bytes(content[8:10], "little")
        header = content[10 : 10 + length].decode("ascii")
        assert "'descr': '<f4'" in header
        assert "'fortran_order': False" in header
        assert f"'shape': {array.shape}" in header
        assert content[10 + length :] == array.tobytes()
    np.save(tmp_path / "fc2.npy", np.asfortranarray(plain["fc2"]))  # as others may write it
    fc2 = read_nbrdf(tmp_path)["fc2"]
    np.testing.assert_array_equal(fc2, plain["fc2"])
    assert (fc2.dtype, fc2.flags.c_contiguous) == (np.float32, True)


def test_evaluate_worked_value_and_gradients() -> None:
    weights = {part: np.zeros(shape, np.float32) for part, shape in NBRDF_ARRAY_SHAPES.items()}
    weights["fc1"][2, 0] = 1  # cos theta_h
    weights["fc1"][3, 1] = 1  # x of the difference vector
    weights["fc1"][5, 2] = -1  # -cos theta_d: the ReLU drops it
    weights["fc2"][0, 0], weights["fc2"][1, 1], weights["fc2"][2, 2] = 1, 1, 1
    weights["fc3"][0, 0], weights["fc3"][1, 1], weights["fc3"][2, 2] = 1, 2, 1
    weights["b3"][:] = 0.25, 0, -1
    theta_h, theta_d, phi_d = 0.4, 0.7, 0.3
    result = evaluate_nbrdf(weights, torch.tensor([[[theta_h, theta_d, phi_d]]], dtype=torch.float64))
    expected = [math.exp(math.cos(theta_h) + 0.25) - 1, math.exp(2 * math.sin(theta_d) * math.cos(phi_d)) - 1, 0]
    torch.testing.assert_close(result, torch.tensor([[expected]], dtype=torch.float64))
    tensors = {part: torch.from_numpy(array).requires_grad_() for part, array in make_weights().items()}
    evaluate_nbrdf(tensors, torch.rand(64, 3)).sum().backward()
    assert all(tensor.grad is not None for tensor in tensors.values())


def test_files_with_a_prefix_are_found_and_read(tmp_path: Path) -> None:
    make_network(tmp_path, "red_felt_", seed=3)
    np.testing.assert_array_equal(read_nbrdf(tmp_path)["fc3"], make_weights(3)["fc3"])
    assert find_paths(find, tmp_path) == ([tmp_path / "red_felt"], [])
    make_network(tmp_path, "gold_", seed=4)
    with pytest.raises(ValueError, match=r"2 networks \(gold, red_felt\), expected one; name it: .*gold"):
        read_nbrdf(tmp_path)
    assert find_paths(find, tmp_path)[0] == [tmp_path / "gold", tmp_path / "red_felt"]
    np.testing.assert_array_equal(read_nbrdf(tmp_path / "gold")["b1"], make_weights(4)["b1"])
    assert find_paths(find, tmp_path / "gold")[0] == [tmp_path / "gold"]
    make_network(tmp_path, "", seed=5)
    np.testing.assert_array_equal(read_nbrdf(tmp_path)["b1"], make_weights(5)["b1"])


def test_complete_networks_are_found(tmp_path: Path) -> None:
    for name in ("set/tin", "set/gold"):
        make_network(tmp_path / name)
    make_network(tmp_path / "set" / "broken")
    (tmp_path / "set" / "broken" / "b2.npy").unlink()
    make_network(tmp_path / "set" / ".hidden")
    (tmp_path / "set" / "notes.txt").write_text("")
    found, skipped = find_paths(find, tmp_path)
    assert found == [tmp_path / "set" / "gold", tmp_path / "set" / "tin"]
    assert len(skipped) == 1
    assert "broken: no file for b2, expected fc1.npy" in skipped[0]
    with pytest.raises(ValueError, match="no such file or folder"):
        find(tmp_path / "none")
    shutil.rmtree(tmp_path / "set")
    with pytest.raises(ValueError, match="no NBRDF network, expected"):
        find(tmp_path)
    make_network(tmp_path)
    (tmp_path / "b3.npy").unlink()
    os.mkfifo(tmp_path / "b3.npy")  # is not waited for
    with pytest.raises(ValueError, match="no file for b3"):
        read_nbrdf(tmp_path)


def keras(path: Path, seed: int = 0, drop: str = "") -> Path:
    """A network as Keras 2 saves models: dense layers of any name, an optimizer's state beside them."""
    h5py = pytest.importorskip("h5py", reason='h5py is not installed: pip install "metapp[nbrdf]"')
    weights = make_weights(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for layer in (1, 2, 3):
            group = file.create_group(f"model_weights/dense_{layer + 6}/dense_{layer + 6}")
            for part, name in ((f"fc{layer}", "kernel:0"), (f"b{layer}", "bias:0")):
                if part != drop:
                    group[name] = weights[part]
        file["optimizer_weights/moments"] = np.zeros((21, 21))
    return path


def test_keras_models_are_read(tmp_path: Path) -> None:
    path = keras(tmp_path / "set" / "gold.h5", 3)
    for part, array in read_nbrdf(path).items():
        np.testing.assert_array_equal(array, make_weights(3)[part])
        assert array.dtype == np.float32
    keras(tmp_path / "set" / "below" / "TIN.H5", 4)
    make_network(tmp_path / "set" / "zinc")
    (path.parent / "gold.json").write_text("{}")
    found, skipped = find_paths(find, tmp_path)
    assert [place.name for place in found] == ["TIN.H5", "gold.h5", "zinc"]
    assert skipped == []
    assert recognises(path)
    assert recognises(path.parent)
    assert find_paths(find, path) == ([path], [])
    assert read_task(path, 64).name == "gold"


@pytest.mark.parametrize(("drop", "message"), {"fc2": "dense layers (6, 21), (21, 3), expected (6, 21), (21, 21), ",
                                               "b2": "b2: shape (0,), expected (21,)"}.items())  # fmt: skip
def test_keras_models_of_other_networks_are_refused(tmp_path: Path, drop: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        read_nbrdf(keras(tmp_path / "a.h5", drop=drop))


def test_files_that_are_no_keras_model_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n and no more")
    if importlib.util.find_spec("h5py"):
        with pytest.raises(ValueError, match=r"a\.h5: not a readable HDF5 file \(.*\), expected a Keras model"):
            read_nbrdf(path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ValueError, match=r"a\.h5: a network in HDF5, which needs h5py; pip install \"metapp\[nbrdf\]"):
        read_nbrdf(path)
    with pytest.raises(ValueError, match=r"1 networks in HDF5 \(a\.h5, \.\.\.\), which need h5py; pip install"):
        find(tmp_path)
    make_network(tmp_path / "tin")
    found, (line,) = find_paths(find, tmp_path)
    assert found == [tmp_path / "tin"]
    assert "which need h5py" in line


class Touch:
    """Writes a file when it is unpickled."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return open, (self.path, "w")


TRAP = Touch("loaded")
NOT_READABLE = "not a readable .npy file"


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


WHOLE = npy(np.zeros((6, 21), np.float32))
BAD = {
    "transposed": (npy(np.zeros((21, 6), np.float32)), "shape (21, 6), expected (6, 21); transpose it"),
    "NaN": (npy(np.full((6, 21), np.nan, np.float32)), "holds NaN"),
    "integers": (npy(np.zeros((6, 21), np.int64)), "values of type int64, expected float32"),
    "objects": (npy(np.array([TRAP] * 3, dtype=object)), f"{NOT_READABLE} ("),
    "a pickle": (pickle.dumps(TRAP), f"{NOT_READABLE} (the magic string"),
    "a header that asks for memory": (
        WHOLE.replace(b"(6, 21), }           ", b"(60000, 2100000000), }"), NOT_READABLE
    ),
    "empty": (b"", NOT_READABLE),
    "cut in its header": (WHOLE[:70], NOT_READABLE),
    "cut in its values": (WHOLE[:300], NOT_READABLE),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_files_that_are_no_array_are_refused_in_one_line_and_never_unpickled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    content, message = BAD[kind]
    (make_network(tmp_path / "a") / "fc1.npy").write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_nbrdf(tmp_path / "a")
    assert str(caught.value).startswith(f"{tmp_path / 'a' / 'fc1.npy'}: ")
    assert not Path("loaded").exists()


def test_invalid_networks_are_not_written(tmp_path: Path) -> None:
    weights = make_weights()
    with pytest.raises(ValueError, match="weights b1, expected fc1, fc2"):
        write_nbrdf(tmp_path, {"b1": weights["b1"]})
    with pytest.raises(ValueError, match=r"fc3.npy: shape \(3, 21\), expected \(21, 3\); transpose it"):
        write_nbrdf(tmp_path, {**weights, "fc3": weights["fc3"].T})
    with pytest.raises(ValueError, match=r"b3.npy: holds NaN"):
        write_nbrdf(tmp_path, {**weights, "b3": np.full(3, np.nan)})
    assert list(tmp_path.iterdir()) == []

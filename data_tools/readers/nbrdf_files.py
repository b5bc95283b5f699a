"""Neural BRDFs of Sztrajman et al. 2021, "Neural BRDF Representation and Importance Sampling": read, write, evaluate.

A network is six `.npy` files, float32: fc1 (6, 21), fc2 (21, 21), fc3 (21, 3), stored [inputs, outputs], and the
biases b1, b2 (21,), b3 (3,). It reads the half vector (phi_h = 0) and the difference vector, both of unit length;
hidden layers are ReLU; reflectance = max(exp(out) - 1, 0), linear RGB in 1/sr. A folder holds one network (`fc1.npy`,
...), or several, each with its name in front (`gold_fc1.npy`, ...). Or a network is a Keras model in HDF5, `gold.h5`,
as the paper's authors publish them.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.lib import format as npy
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers import brdf_task
from data_tools.readers.input_source import Source, Sources
from data_tools.readers.listing import files_below
from metapp.appearance.geometry import half_difference_vectors
from metapp.learning.task import Task
from metapp.storage.files import check_readable, open_regular, write_atomically

if TYPE_CHECKING:
    from metapp.apps.brdf.reflectance import Reflectance

UNITS = brdf_task.UNITS
NBRDF_ARRAY_SHAPES = {"fc1": (6, 21), "fc2": (21, 21), "fc3": (21, 3), "b1": (21,), "b2": (21,), "b3": (3,)}

_FILE_NAME = re.compile(r"(?:(?P<name>.*)_)?(?P<part>fc[123]|b[123])\.npy")
_EXPECTED_FILES = "expected fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy"
_KERAS_SUFFIXES = (".h5", ".hdf5")
INSTALL_HDF5 = 'pip install "metapp[nbrdf]"'


def find(path: Path) -> Sources:
    """Find networks by the names of their files, in a folder at any depth, without hidden ones.

    Returns:
        Networks, sorted by path: a file, a network's folder, or folder/name if its files have a name in front. And a
        line for each network of a folder that lacks files, and for those that h5py is missing for.

    Raises:
        ValueError: the path is neither folder nor network, or a folder without a whole network.
    """
    if _is_keras(path):
        return [_make_source(path)], []
    if not path.is_dir():
        _find_network_files(path)
        return [_make_source(path)], []
    files_by_network = _group_networks(files_below(path, ".npy"))
    whole_networks = sorted(
        network for network, files in files_by_network.items() if len(files) == len(NBRDF_ARRAY_SHAPES)
    )
    skipped = [
        _describe_missing(network, files_by_network[network])
        for network in sorted(files_by_network.keys() - set(whole_networks))
    ]
    if (keras := files_below(path, _KERAS_SUFFIXES)) and importlib.util.find_spec("h5py"):
        whole_networks = sorted([*whole_networks, *keras])
    elif keras:
        skipped.insert(
            0, f"{path}: {len(keras)} networks in HDF5 ({keras[0].name}, ...), which need h5py; {INSTALL_HDF5}."
        )
    if not whole_networks:
        raise ValueError(skipped[0] if skipped else f"{path}: no NBRDF network, {_EXPECTED_FILES}; name their folder.")
    return [_make_source(network) for network in whole_networks], skipped


def _make_source(path: Path) -> Source:
    """Return a network as a source, named by its file or folder."""
    return Source(path.stem if _is_keras(path) else path.resolve().name, path)


def recognises(path: str | Path) -> bool:
    """Tell whether a path is an HDF5 file, or a folder that holds one or files named as an NBRDF network's."""
    path = Path(path)
    return _is_keras(path) or (
        path.is_dir() and bool(files_below(path, _KERAS_SUFFIXES) or _group_networks(files_below(path, ".npy")))
    )


def export(asset: Reflectance, folder: Path, provenance: Mapping[str, object]) -> None:
    """Write the network of reflectance, w1..w3 [out, in] and b1..b3 [out, 1], as an NBRDF folder."""
    theta = asset.theta
    weights = {f"fc{layer}": theta[f"w{layer}"].T for layer in (1, 2, 3)}
    write_nbrdf(folder, weights | {f"b{layer}": theta[f"b{layer}"].flatten() for layer in (1, 2, 3)})


def read_task(path: Path, samples: int = 65_536) -> Task:
    """Read a network as a BRDF task named by its file or folder; warn if its values are implausible.

    Args:
        path: the network, as :func:`find` returns it.
        samples: the number of samples.

    Raises:
        ValueError: the network cannot be read; see :func:`read_nbrdf`.
    """
    evaluate = partial(evaluate_nbrdf, read_nbrdf(path))
    name = path.stem if _is_keras(path) else path.resolve().name
    return brdf_task.make_measured_task(name, evaluate, samples, path)


def read_nbrdf(folder: str | Path) -> dict[str, NDArray[np.float32]]:
    """Read the weights of a network: float32 arrays in C order, with the names and shapes of NBRDF_ARRAY_SHAPES.

    Args:
        folder: the network, as :func:`find` returns it, or the folder of a single one.

    Raises:
        ValueError: there is no such folder, files are missing, or there are several networks; arrays have another shape
            or type, or values that are not finite; h5py is not installed, for an HDF5 file.
    """
    if _is_keras(Path(folder)):
        return _read_keras(Path(folder))
    files = _find_network_files(Path(folder))
    return {part: _read_part(files[part], shape) for part, shape in NBRDF_ARRAY_SHAPES.items()}


def write_nbrdf(folder: str | Path, weights: Mapping[str, NDArray[np.floating] | Tensor]) -> None:
    """Write a network as six little-endian float32 files, each whole or not at all.

    Arrays are in C order: numpy stores a transposed view in Fortran order, which the paper's Mitsuba plugin reads
    scrambled.

    Args:
        folder: the folder to write to.
        weights: arrays or tensors, with the names and shapes of NBRDF_ARRAY_SHAPES.

    Raises:
        ValueError: names are missing or unknown, or arrays have another shape or values that are not finite; nothing is
            written then.
    """
    folder = Path(folder)
    if set(weights) != set(NBRDF_ARRAY_SHAPES):
        raise ValueError(
            f"{folder}: weights {', '.join(sorted(weights)) or 'none'}, expected {', '.join(NBRDF_ARRAY_SHAPES)}; "
            "give them all."
        )
    numpy_arrays = {
        part: value.detach().cpu().numpy() if isinstance(value, Tensor) else value for part, value in weights.items()
    }
    arrays = {part: np.ascontiguousarray(numpy_arrays[part], "<f4") for part in NBRDF_ARRAY_SHAPES}
    for part, array in arrays.items():
        _check_part(array, NBRDF_ARRAY_SHAPES[part], str(folder / f"{part}.npy"))

    def write(array: NDArray[np.float32], path: Path) -> None:
        with path.open("wb") as stream:
            npy.write_array(stream, array, allow_pickle=False)

    for part, array in arrays.items():
        write_atomically(folder / f"{part}.npy", partial(write, array))


def evaluate_nbrdf(weights: Mapping[str, NDArray[np.floating] | Tensor], angles: Tensor) -> Tensor:
    """Evaluate a network.

    Args:
        weights: arrays or tensors, with the names and shapes of NBRDF_ARRAY_SHAPES.
        angles: theta_h, theta_d, phi_d in rad, [..., 3].

    Returns:
        Reflectance [..., 3] in 1/sr, linear RGB, >= 0.
    """
    tensors = {part: torch.as_tensor(array).to(angles) for part, array in weights.items()}
    hidden = torch.relu(half_difference_vectors(angles) @ tensors["fc1"] + tensors["b1"])
    hidden = torch.relu(hidden @ tensors["fc2"] + tensors["b2"])
    return torch.expm1(hidden @ tensors["fc3"] + tensors["b3"]).clamp_min(0)


def _group_networks(files: Iterable[Path]) -> dict[Path, dict[str, Path]]:
    """Return the files of each network, by its path and by the names of its arrays."""
    networks: dict[Path, dict[str, Path]] = {}
    for file in files:
        if match := _FILE_NAME.fullmatch(file.name):
            networks.setdefault(file.parent / (match["name"] or ""), {})[match["part"]] = file
    return networks


def _find_network_files(network: Path) -> dict[str, Path]:
    """Return the files of one network by the names of its arrays.

    Raises:
        ValueError: files are missing, or a folder has several networks.
    """
    if network.is_dir():
        # files alone: reading a pipe would wait for a writer
        networks = _group_networks(sorted(file for file in network.iterdir() if file.is_file()))
        if network not in networks and len(networks) > 1:
            names = ", ".join(place.name for place in sorted(networks))
            found = f"{len(networks)} networks ({names})"
            raise ValueError(f"{network}: {found}, expected one; name it: {min(networks)}.")
        network = network if network in networks or not networks else next(iter(networks))
        files = networks.get(network, {})
    else:  # by name, so that a folder of many networks is not listed
        files = {
            part: file
            for part in NBRDF_ARRAY_SHAPES
            if (file := network.parent / f"{network.name}_{part}.npy").is_file()
        }
        if not files:
            found = "a file" if network.is_file() else "no such file or folder"
            alternatives = f"or {network.name}_fc1.npy, ..., or a Keras model (.h5)"
            raise ValueError(f"{network}: {found}, {_EXPECTED_FILES} in it, {alternatives}; check the path.")
    if len(files) < len(NBRDF_ARRAY_SHAPES):
        raise ValueError(_describe_missing(network, files))
    return files


def _is_keras(path: Path) -> bool:
    """Tell whether a path is a Keras model, by its suffix."""
    return path.suffix.lower() in _KERAS_SUFFIXES and path.is_file()


def _read_keras(path: Path) -> dict[str, NDArray[np.float32]]:
    """Read the three dense layers of a Keras model or of its weights, told by their shapes; nothing in the file is run.

    Raises:
        ValueError: h5py is not installed, the file is not HDF5, or it holds no NBRDF.
    """
    try:
        import h5py
    except ImportError:
        raise ValueError(f"{path}: a network in HDF5, which needs h5py; {INSTALL_HDF5}.") from None
    layers: dict[str, dict[int, NDArray[np.floating]]] = {}  # arrays of a layer by their number of axes

    def visit(name: str, node: h5py.Dataset | h5py.Group) -> None:
        if isinstance(node, h5py.Dataset) and node.size <= 21 * 21 and not name.startswith("optimizer"):
            layers.setdefault(node.parent.name, {})[node.ndim] = np.array(node, np.float32)

    try:
        with open_regular(path) as stream, h5py.File(stream, "r") as file:
            file.visititems(visit)
    except Exception as error:  # libhdf5 may raise anything
        reason = (str(error) or type(error).__name__).splitlines()[0][:80]
        raise ValueError(
            f"{path}: not a readable HDF5 file ({reason}), expected a Keras model of an NBRDF; copy it again."
        ) from None
    arrays_by_shape = {arrays[2].shape: arrays for arrays in layers.values() if 2 in arrays}
    kernels = [NBRDF_ARRAY_SHAPES[f"fc{layer}"] for layer in (1, 2, 3)]
    if arrays_by_shape.keys() != set(kernels):
        shapes = ", ".join(map(str, arrays_by_shape)) or "none"
        raise ValueError(
            f"{path}: dense layers {shapes}, expected {', '.join(map(str, kernels))}; give an NBRDF network."
        )
    parts = {f"fc{layer + 1}": arrays_by_shape[kernel][2] for layer, kernel in enumerate(kernels)}
    parts |= {f"b{layer + 1}": arrays_by_shape[kernel].get(1, np.empty(0)) for layer, kernel in enumerate(kernels)}
    for part, array in parts.items():
        _check_part(array, NBRDF_ARRAY_SHAPES[part], f"{path}: {part}")
    return parts


def _describe_missing(network: Path, files: Mapping[str, Path]) -> str:
    """Return the line about a network that lacks some of its files."""
    missing = ", ".join(part for part in NBRDF_ARRAY_SHAPES if part not in files)
    return f"{network}: no file for {missing}, {_EXPECTED_FILES}; the network is incomplete."


def _read_part(path: Path, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Read an array of a network, float32 in C order.

    Raises:
        ValueError: the file is damaged, or holds another type, another shape or values that are not finite.
    """
    check_readable(path)
    try:
        # mapped, so that a false header cannot ask for more memory than the file has; pickled objects are refused
        mapped = npy.open_memmap(path, mode="r")
    except Exception as error:  # numpy lets pass whatever Python's tokenizer raises at a damaged header
        # the message repeats the header, which may be long
        reason = (str(error) or type(error).__name__).splitlines()[0][:80].rstrip(".")
        raise ValueError(
            f"{path}: not a readable .npy file ({reason}), expected float32 {shape}; save it again."
        ) from None
    if mapped.dtype.kind != "f":
        raise ValueError(f"{path}: values of type {mapped.dtype}, expected float32; convert them.")
    with np.errstate(over="ignore"):  # doubles beyond float32 are refused by the check below
        array = np.array(mapped, dtype=np.float32, order="C")
    _check_part(array, shape, str(path))
    return array


def _check_part(array: NDArray[np.floating], shape: tuple[int, ...], subject: str) -> None:
    """Raise ValueError for an array of another shape, or with values that are not finite."""
    if array.shape != shape:
        remedy = "; transpose it: weights are stored [inputs, outputs]" if array.shape == shape[::-1] else ""
        raise ValueError(f"{subject}: shape {array.shape}, expected {shape}{remedy}.")
    if not np.isfinite(array).all():
        raise ValueError(f"{subject}: holds NaN or infinite values, expected finite weights; export the network again.")

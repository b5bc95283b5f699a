"""Places of camera and flash beside several photos of one material."""

import os
from pathlib import Path

import pytest
import torch

from data_tools.readers.flash_places import CAMERA, LIGHT, SIZE
from metapp.extensions.several.places import read_places


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / CAMERA).write_text("1,0,16\n-2,4,8\n\n")
    (tmp_path / LIGHT).write_text("0,2,16\n-2,4,8\n")
    (tmp_path / SIZE).write_text("8.0\n")
    return tmp_path


def test_places_are_in_half_sides(folder: Path) -> None:
    places = read_places(folder, 2)
    torch.testing.assert_close(places.camera, torch.tensor([[0.25, 0.0, 4.0], [-0.5, 1.0, 2.0]]))
    torch.testing.assert_close(places.light, torch.tensor([[0.0, 0.5, 4.0], [-0.5, 1.0, 2.0]]))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        (CAMERA, "1,0,16\n", "1 lines, expected 2"),
        (LIGHT, "1,0\n1,0,3\n", "line '1,0', expected 3 finite"),
        (LIGHT, "1,0,nan\n1,0,3\n", "expected 3 finite"),
        (CAMERA, "1,0,5\n1,0,-3\n", "place 2 has z -3 cm"),
        (SIZE, "0\n", "0, expected the patch's side in cm, 1e-05 to 100000"),
        (SIZE, "1e-38\n", "1e-38, expected the patch's side"),
        (SIZE, "1e300\n", r"1e\+300, expected the patch's side"),
        (CAMERA, "1,0,5\n1e300,0,3\n", r"place 2 is 1e\+300 cm away, expected 8000 at most"),
        (LIGHT, "1,0,1e39\n1,0,3\n", r"place 1 is 1e\+39 cm away"),
        (SIZE, "wide\n", "line 'wide', expected 1 finite"),
    ],
)
def test_malformed_files_are_refused_in_one_line(folder: Path, name: str, text: str, message: str) -> None:
    (folder / name).write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_places(folder, 2)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", [CAMERA, LIGHT, SIZE])
def test_a_pipe_is_not_waited_for(folder: Path, name: str) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(ValueError, match=f"{name}: a pipe or device, expected a file"):
        read_places(folder, 2)


@pytest.mark.parametrize("name", [CAMERA, LIGHT, SIZE])
def test_a_missing_file_is_refused(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(ValueError, match=name):
        read_places(folder, 2)

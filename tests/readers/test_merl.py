"""MERL tables: values and bins agree with worked values, tables read back as written, and damaged ones are refused."""

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers.merl import (
    CHANNEL_SCALES,
    FILE_BYTES,
    evaluate_merl,
    find,
    merl_centres,
    merl_index,
    merl_valid_mask,
    read_merl,
    tabulate_merl,
    write_merl,
)
from metapp.appearance.geometry import is_above_horizon
from tests.found_paths import find_paths


@pytest.fixture(scope="module")
def merl_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of random values with a quarter of invalid entries, marked in several ways, and negative noise."""
    rng = np.random.default_rng(0)
    planes = rng.lognormal(2, 3, (3, 90, 90, 180))
    planes[:, rng.random((90, 90, 180)) < 0.25] = -1.0
    planes[:, 0, 0, 0] = -0.3, -1e-300, -17.0
    planes[:, 0, 0, 1] = 1500.0, 3000.0, 4500.0
    planes[:, 0, 0, 2] = 2.0, -0.5, 0.0
    planes[:, 1, 2, 3] = 7.0, 8.0, 9.0
    path = tmp_path_factory.mktemp("merl") / "gold.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + planes.tobytes())
    return path


def test_known_values_are_read(merl_file: Path) -> None:
    table = read_merl(merl_file)
    assert table.shape == (90, 90, 180, 3)
    assert table.dtype == np.float64
    np.testing.assert_allclose(table[0, 0, 1], [1.0, 2.3, 4.98], rtol=1e-15)
    np.testing.assert_array_equal(table[1, 2, 3], np.array([7.0, 8.0, 9.0]) * CHANNEL_SCALES)
    # red of (1, 2, 3) lies at phi_d + 180 * (theta_d + 90 * theta_h) doubles behind the header
    assert struct.unpack_from("<d", merl_file.read_bytes(), 12 + 8 * (3 + 180 * (2 + 90)))[0] == 7.0
    valid = merl_valid_mask(table)
    assert not valid[0, 0, 0]
    assert valid[0, 0, 2]
    assert (table[~valid] < 0).all()
    assert 0.7 < valid.mean() < 0.8


def planes_of(path: Path) -> np.ndarray:
    """The numbers of a file as they are, [3, 90, 90, 180]."""
    return np.fromfile(path, "<f8", offset=12).reshape(3, 90, 90, 180)


def test_tables_read_back_as_written(merl_file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "new" / "copy.binary"
    write_merl(copy, read_merl(merl_file))
    assert list(copy.parent.iterdir()) == [copy]
    assert copy.read_bytes()[:12] == merl_file.read_bytes()[:12]
    planes, expected = planes_of(copy), planes_of(merl_file)
    np.testing.assert_allclose(planes, expected, rtol=2.3e-16)
    np.testing.assert_array_equal(planes == -1, expected == -1)


def test_index_inverts_centres_with_worked_bins() -> None:
    centres = merl_centres()
    assert centres.shape == (90, 90, 180, 3)
    expected = [(0.5 / 90) ** 2 * math.pi / 2, 2.5 / 90 * math.pi / 2, 179.5 / 180 * math.pi]
    torch.testing.assert_close(centres[0, 2, 179], torch.tensor(expected))
    torch.testing.assert_close(centres[89, 0, 0, 0], torch.tensor((89.5 / 90) ** 2 * math.pi / 2))
    angles = torch.tensor(
        [
            [0.0, 0.0, 0.0],
            [math.pi / 2, math.pi / 2, math.pi - 1e-3],  # the ends of the thetas belong to the last bins
            [math.pi / 8, math.pi / 4 + 1e-3, 1e-3],  # a quarter of pi/2 is half-way in square-root spacing
            [0.0, 0.0, -1e-3],  # reciprocity: phi_d - pi
            [0.0, 0.0, math.pi + 1e-3],
        ]
    )
    assert merl_index(angles).tolist() == [0, 90 * 90 * 180 - 1, 180 * (45 + 90 * 45), 179, 0]
    assert torch.equal(merl_index(centres).reshape(-1), torch.arange(90 * 90 * 180))


def test_evaluate_interpolates_wraps_phi_and_holds_the_ends() -> None:
    slopes = torch.tensor([[0.3, 0.1, 0.2], [0.0, 0.5, 0.1], [0.2, 0.2, 0.7]], dtype=torch.float64)
    table = (merl_centres().double() @ slopes + 0.4).numpy()
    # Within the outermost centres: beyond, the value is held, and phi_d goes round.
    unit = torch.rand(5000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    low, high = merl_centres()[0, 0, 0].double(), merl_centres()[-1, -1, -1].double()
    angles = low + unit * (high - low)
    torch.testing.assert_close(evaluate_merl(table, angles), angles @ slopes + 0.4, rtol=0, atol=1e-6)
    torch.testing.assert_close(evaluate_merl(table, angles.float()), (angles @ slopes + 0.4).float(), rtol=0, atol=1e-5)
    table = np.zeros((90, 90, 180, 3))
    table[0, 0, 0], table[0, 0, 179] = 1.0, 3.0
    angles = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, math.pi], [0.0, 0.0, math.pi / 360]], dtype=torch.float64)
    torch.testing.assert_close(evaluate_merl(table, angles)[:, 0], torch.tensor([2.0, 2.0, 1.0], dtype=torch.float64))


def test_evaluate_ignores_invalid_entries() -> None:
    table = np.full((90, 90, 180, 3), -1.0) * CHANNEL_SCALES
    table[10, 10, 10] = 5.0
    table[20, 20, 20] = 0.5, -0.1, 0.5  # noise in one channel: valid, and read as 0
    centres = merl_centres()
    near = torch.lerp(centres[10, 10, 10], centres[11, 11, 11], 0.3)
    far = centres[50, 50, 50]
    result = evaluate_merl(table, torch.stack([near, far, centres[20, 20, 20]]))
    torch.testing.assert_close(result, torch.tensor([[5.0] * 3, [0.0] * 3, [0.5, 0.0, 0.5]]))
    assert evaluate_merl(np.ones((90, 90, 180, 3)), torch.zeros(2, 4, 3)).shape == (2, 4, 3)


def test_brdfs_are_tabulated_at_bin_centres(tmp_path: Path) -> None:
    table = tabulate_merl(lambda angles: angles + 1)
    centres, above = merl_centres(), is_above_horizon(merl_centres()).numpy()
    np.testing.assert_array_equal(merl_valid_mask(table), above)
    np.testing.assert_allclose(table[above], centres.numpy()[above] + 1, rtol=1e-6)
    write_merl(tmp_path / "a.binary", table)
    planes = planes_of(tmp_path / "a.binary")
    assert (planes[:, ~above] == -1.0).all()
    assert tabulate_merl(lambda angles: -angles).max() == 0.0
    with pytest.raises(ValueError, match=r"a\.binary: [0-9,]+ values are NaN or infinite"):
        write_merl(tmp_path / "a.binary", tabulate_merl(lambda angles: angles * math.nan))


def test_files_that_are_no_table_are_refused_in_one_line(merl_file: Path, tmp_path: Path) -> None:
    whole, path = merl_file.read_bytes(), tmp_path / "gold.binary"
    assert len(whole) == FILE_BYTES
    expected = "expected 34,992,012 (12-byte header + 3x90x90x180 doubles)"
    infinite = struct.pack("<2d", math.inf, -math.inf)
    for content, message in (
        (whole[: 2**25], f"33,554,432 bytes, {expected}; the download is probably incomplete"),
        (whole + b"\n", f"34,992,013 bytes, {expected}; the file has something appended"),
        (b"hello", f"5 bytes, {expected}; not a MERL file"),
        (whole[:8] + struct.pack("<i", 360) + whole[12:], "header 90x90x360, expected 90x90x180; not a MERL file"),
        (whole[:628] + infinite + whole[644:], "2 values are NaN or infinite"),
        (whole[:628] + struct.pack("<d", 1e300) + whole[636:], "values of up to 1e+300, expected at most 1e+30"),
        (whole[:628] + struct.pack("<d", -1e300) + whole[636:], "values of up to 1e+300, expected at most 1e+30"),
        (whole[:12] + b"\xbf" * (FILE_BYTES - 12), "0.00% of the entries are valid"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=re.escape(f"gold.binary: {message}")):
            read_merl(path)


def test_merl_files_are_found(merl_file: Path, tmp_path: Path) -> None:
    (tmp_path / "brdfs").mkdir()
    (tmp_path / "brdfs" / "b.binary").symlink_to(merl_file)
    (tmp_path / "readme.txt").write_text("about")
    (tmp_path / ".hidden").write_text("")
    files, skipped = find_paths(find, tmp_path)
    assert files == [tmp_path / "brdfs" / "b.binary"]
    assert len(skipped) == 1
    assert "readme.txt: 5 bytes" in skipped[0]
    with pytest.raises(ValueError, match="no such file"):
        find(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"empty: no MERL file, expected \*.binary files"):
        find(tmp_path / "empty")

"""A folder of photographs that are no squares, from the command line to its files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import metapp as package
from tests.apps.rti.scenes import dome, photograph, wavy_maps
from tests.cli.messages import says
from tests.pictures import write_image

LAMPS = 24


@pytest.fixture
def coin(tmp_path: Path) -> Path:
    """Photographs of 40 x 56 px under 24 lamps, with their text."""
    folder, lamps = tmp_path / "coin", dome(LAMPS)
    rows = [str(LAMPS)]
    for number, photo in enumerate(photograph(wavy_maps(56, 0.04), lamps)):
        write_image(folder / f"{number:02d}.png", np.ascontiguousarray(photo[:, :40].permute(1, 2, 0).numpy()))
        rows.append(f"{number:02d}.png " + " ".join(f"{value:.6f}" for value in lamps[number].tolist()))
    (folder / "coin.lp").write_text("\n".join(rows) + "\n")
    return folder


@pytest.mark.parametrize("paradigm", ["general", "quickft", "meta"])
def test_maps_are_as_large_as_the_photographs(coin: Path, paradigm: str) -> None:
    fit = package.fit("svbrdf_nonstationary", coin, paradigm=paradigm)
    assert fit.settings["recipe"] == "rti"
    assert {values.shape[:2] for values in fit.maps.values()} == {(40, 56)}
    assert fit.relight([[0.0, 0, 1]]).shape == (1, 40, 56, 3)
    truth = wavy_maps(56).normal[:, :40].permute(1, 2, 0).numpy()
    angles = np.degrees(np.arccos((fit.maps["normal"] * truth).sum(-1).clip(-1, 1)))
    assert angles.mean() < 3
    assert fit.figures["left_out_db"] > 30
    assert fit.warning == ""


def test_the_line_of_a_fit_says_how_well_photographs_are_predicted(
    metapp: Callable, coin: Path, tmp_path: Path
) -> None:
    result = metapp("general", "svbrdf_nonstationary", coin, "--out", tmp_path / "runs")
    assert says(result.err, "recipe rti", "photos under many lamps"), result.err
    assert says(result.out + result.err, "photos that were left out are predicted to", "dB", "%")
    entry = metapp("general", "svbrdf_nonstationary", coin, "--json", "--out", tmp_path / "json").json_result["tasks"][
        0
    ]
    assert entry["left_out_db"] > 30

"""Exports of a fit of photographs under many lamps, by the command."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.storage.image_writers import write_png
from tests.apps.rti.scenes import dome, lit_task
from tests.cli.messages import says

APP = "svbrdf_nonstationary"


@pytest.fixture
def coin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of photographs with a text of light directions, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    lamps = dome(12)
    lines = [f"{number}.png {x:.4f} {y:.4f} {z:.4f}\n" for number, (x, y, z) in enumerate(lamps.tolist())]
    for number, photo in enumerate(lit_task(32, len(lamps)).data["lit"]):
        write_png(photo.movedim(0, -1) / 255, {"encoding": "sRGB"}, tmp_path / "coin" / f"{number}.png")
    (tmp_path / "coin" / "coin.lp").write_text("".join([f"{len(lamps)}\n", *lines]))
    return tmp_path / "coin"


@pytest.mark.long
def test_photographs_are_looked_for_where_they_were(coin: Path, metapp: Callable) -> None:
    fitted = metapp("overfit", APP, coin, "--recipe", "rti", "--steps", "1", "--export", "ptm,relight", "--json")
    run = Path(fitted.json_result["out"])
    (ptm,) = run.rglob("coin.ptm")
    (info,) = run.rglob("info.json")
    assert info.parent.name == "coin"
    again = metapp("export", run, "ptm", "--out", "again")
    assert again.code == 0
    assert (Path("again") / "coin.ptm").read_bytes() == ptm.read_bytes()
    coin.rename("moved")
    assert says(metapp("export", run, "relight", "--out", "lost").error, "coin", "relight", "input")
    assert not Path("lost").exists()
    Path("moved").rename(coin)


@pytest.mark.long
def test_fits_of_one_photo_cannot_be_relit(tmp_path: Path, metapp: Callable) -> None:
    photo = tmp_path / "leaf.png"
    write_png(torch.rand(64, 64, 3), {"encoding": "sRGB"}, photo)
    fitted = metapp("general", APP, photo, "--recipe", "quick", "--out", tmp_path / "out", "--json")
    refused = metapp("export", fitted.json_result["out"], "ptm", "--out", tmp_path / "ptm")
    assert says(refused.error, "leaf", "photos under many lamps", "rti")

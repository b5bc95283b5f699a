"""What was learned at the quick size fits at the full one: checkpoints are put on the application's own grid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from metapp.runs.checkpoints import with_checkpoint
from metapp.runs.options import fit_options
from metapp.runs.recipes import shipped_path
from metapp.runs.run import Run
from metapp.storage.checkpoints import load_checkpoint, save_checkpoint


@pytest.mark.parametrize("observe", ["reference", "photo"])
@pytest.mark.parametrize("name", ["illumination", "svbrdf_nonstationary"])
def test_meta_starts_from_what_quick_learned(name: str, observe: str, tmp_path: Path) -> None:
    planned = Run.of(fit_options(name, observe=observe, recipe="full", out=tmp_path))
    assert planned.app == replace(planned.recipe.app, protocol=observe)
    prepared = with_checkpoint(planned).phi
    field = planned.app.network
    assert prepared.alpha["rate.z"].shape[-2:] == (field.rows, field.columns)
    file = f"{planned.recipe.rule}{'-photo' if observe == 'photo' else ''}"
    learned = load_checkpoint(shipped_path(name, file, "full"))[0].alpha
    assert float(prepared.alpha["rate.z"].mean()) == pytest.approx(float(learned["rate.z"].mean()), rel=1e-4)
    assert all(torch.equal(prepared.alpha[key], learned[key]) for key in learned if learned[key].ndim < 4)


def test_another_number_of_channels_is_refused(tmp_path: Path) -> None:
    start, info = load_checkpoint(shipped_path("illumination", "meta-lgd"))
    bad = start._replace(alpha=start.alpha | {"rate.z": torch.zeros(1, 7, 16, 32)})
    save_checkpoint(tmp_path / "bad.safetensors", bad, info)
    options = fit_options("illumination", recipe="full", out=tmp_path, checkpoint=tmp_path / "bad.safetensors")
    with pytest.raises(ValueError, match=r"alpha rate.z is \(steps, 7, 16, 32\), expected \(steps, 8, 32, 64\)"):
        with_checkpoint(Run.of(options))


def test_a_rule_that_ships_at_the_quick_size_alone_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.runs.checkpoints._require_conditions", lambda *_: None)  # VGG may be missing
    with pytest.raises(ValueError, match=r"meta-basis\.safetensors: .*; this one ships for --recipe quick\."):
        with_checkpoint(Run.of(fit_options("texture", rule="meta-basis", out=tmp_path)))

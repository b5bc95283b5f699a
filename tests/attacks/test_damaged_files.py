"""Damaged or hostile records, checkpoints and shards: one line that names the file, never a traceback."""

import json
import re
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save, save_file

from metapp.runs.stored_fits import read_fits
from metapp.storage.checkpoint_files import CHECKPOINT_SCHEMA, read_entry, write_entry
from metapp.storage.fit_folders import PARAMS, RECORD
from tests.cli.messages import says
from tests.kept_fits import fit_of, write_fit
from tests.marked import long

pytestmark = pytest.mark.usefixtures("small_spheres")

SHIPPED = Path(__file__).parents[2] / "metapp" / "checkpoints"
NESTED = "[" * 100_000 + "]" * 100_000


# Records

THETA = {"w": torch.arange(3.0)}


def fit_folder(run: Path, name: str) -> Path:
    """The folder of a fit."""
    return write_fit(run, fit_of(name), THETA).folder


BAD_RECORDS: dict[str, Any] = {
    "text": {"error": "0.5"},
    "text as CPU seconds": {"cpu_seconds": "0.5"},
    "list as name": {"name": ["gold"]},
    "NaN": {"error": float("nan")},
    "no settings": {"settings": None},
    "nested": NESTED,
    "empty": "",
}


@pytest.mark.parametrize("change", BAD_RECORDS.values(), ids=BAD_RECORDS)
def test_a_bad_record_is_passed_over_with_a_warning(tmp_path: Path, change: Any) -> None:
    file = fit_folder(tmp_path, "gold") / RECORD
    fit_folder(tmp_path, "tin")
    text = change if isinstance(change, str) else json.dumps({**json.loads(file.read_text()), **change})
    file.write_text(text, errors="surrogateescape")
    with pytest.warns(UserWarning, match=rf"gold/{RECORD}: no record, expected one of a fit \(.+\); passed over"):
        assert [fit.name for fit in read_fits(tmp_path)] == ["tin"]
    again = fit_folder(tmp_path, "gold")  # another folder if nothing says whose the damaged one is
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert [fit.name for fit in read_fits(tmp_path)] == [again.name, "tin"]


DAMAGED = {
    "settings": [{"app": 1}, {"data": None}, {"recipe": []}, {"rule": 7}, {"paradigm": {}}, {"options": 3}],
    "inputs": ["x", {"data": 1}, 7, [None], [1]],
}


@pytest.mark.parametrize("place", DAMAGED)
def test_a_record_of_other_types_is_one_line(metapp: Callable, fit: Callable, network: Path, place: str) -> None:
    folder = Path(fit("meta", network, "--recipe", "quick", "--json").json_result["tasks"][0]["folder"])
    file = folder / RECORD
    whole = json.loads(file.read_text())
    for value in DAMAGED[place]:
        new = {**whole[place], **value} if place == "settings" else value
        file.write_text(json.dumps({**whole, place: new}))
        for run in (folder, folder.parent):
            for words in (("export", run, "merl"), ("view", run), ("compare", run, run)):
                result = metapp(*words)
                line = result.refusal if run == folder else result.err.splitlines()[0]
                assert re.search(r"/m0/record.json: no record, expected one of a fit \(Expected .*\); ", line), words
                assert (f".{place}" in line, "expected" in result.error) == (True, True), words
                assert len(result.err.splitlines()) == (1 if run == folder else 2)


FOREIGN = {  # each is a record as another program or another version may write it
    "other entries": {"name": "alien", "settings": {"layers": 3}},
    "no recipe": {"recipe": ""},
    "unknown application": {"app": "cloth"},
    "unknown recipe": {"recipe": "huge"},
    "unknown paradigm": {"paradigm": "guess"},
}


@pytest.mark.parametrize(
    "kind", ["unknown application", *(long(kind) for kind in FOREIGN if kind != "unknown application")]
)
def test_a_foreign_record_is_passed_over_where_a_folder_is_read(
    metapp: Callable, fit: Callable, network: Path, kind: str
) -> None:
    change = FOREIGN[kind]
    folder = Path(fit("meta", network, "--recipe", "quick", "--json").json_result["tasks"][0]["folder"])
    own = json.loads((folder / RECORD).read_text())
    foreign = change if "settings" in change else {**own, "name": "alien", "settings": {**own["settings"], **change}}
    for alien in (folder.with_name("alien"), folder.parents[1] / "other" / "alien"):  # the second is the newest run
        shutil.copytree(folder, alien)
        (alien / RECORD).write_text(json.dumps(foreign))
    run = folder.parent
    for words in (("view", run), ("view", run.parent), ("export", run, "merl"), ("compare", run, run)):
        result = metapp(*words)
        assert result.code == 0, words
        assert says(result.err, f"alien/{RECORD}", "passed over"), words
        assert "alien" not in result.out
    assert says(metapp("view", alien).refusal, f"alien/{RECORD}", "expected")
    assert metapp("meta", "brdf", network, "--recipe", "quick", "--out", run.parents[1], "--resume").code == 0


def test_a_fit_without_parameters_ends_an_export_and_is_named(metapp: Callable, fit: Callable, network: Path) -> None:
    folder = Path(fit("meta", network, "--recipe", "quick", "--json").json_result["tasks"][0]["folder"])
    torn = folder.with_name("torn")
    shutil.copytree(folder, torn)
    (torn / PARAMS).unlink()
    for place in (folder.parent, torn):
        assert says(metapp("export", place, "merl").refusal, f"torn/{PARAMS}", "not readable", f"remove {torn}"), place
    assert metapp("export", folder, "merl").code == 0


# Checkpoints

PART = {"a:theta.x": torch.ones(1)}


def described(**headers: object) -> dict[str, str]:
    """The metadata of a checkpoint with these descriptions of entries."""
    return {"metapp": json.dumps({"schema": CHECKPOINT_SCHEMA, "entries": headers})}


NO_CHECKPOINTS = {  # tests/fuzz tries any bytes
    "bare": save(PART, None),
    "other part": save({"a:other.x": torch.ones(1)}, described(a={})),
    "no entries": save(PART, {"metapp": json.dumps({"schema": CHECKPOINT_SCHEMA})}),
    "no description": save(PART, described(a=[])),
    "encoder of none": save(PART, described(a={"encoder_of": "b"})),
    "encoder of nothing": save(PART, described(a={"encoder_of": {}})),
    "encoder of itself": save(PART, described(a={"encoder_of": "a"})),
    **{f"header {header[:20]}": save(PART, {"metapp": header}) for header in ("[]", '{"schema": true}', NESTED)},
    "integers": save({"a:theta.x": torch.ones(2, dtype=torch.int64)}, described(a={})),
    "cut": save(PART, described(a={}))[:-1],
    "pickle": b"\x80\x04N.",
}


@pytest.mark.parametrize("content", NO_CHECKPOINTS.values(), ids=NO_CHECKPOINTS)
def test_files_that_are_no_checkpoint_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "meta.safetensors"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"meta.safetensors: not a checkpoint that metapp wrote") as caught:
        read_entry(path, "a")
    assert "\n" not in str(caught.value)


def write_changed_checkpoint(name: str, changes: dict[str, Any]) -> Path:
    """A rule's checkpoint that ships, with another description or other tensors: None takes one away."""
    checkpoint, info = read_entry(SHIPPED / "brdf" / "quick.safetensors", name)
    for part, new in changes.items():
        if part in checkpoint._fields:
            tensors = getattr(checkpoint, part) | new
            tensors = {key: value for key, value in tensors.items() if value is not None}
            checkpoint = checkpoint._replace(**{part: tensors})
        else:
            info = info | {part: new}
    path = Path("s.safetensors")
    path.unlink(missing_ok=True)
    write_entry(path, name, checkpoint, info)
    return path


CHECKPOINTS: list[tuple[str, dict[str, Any], str]] = [
    ("meta-curvature", {"alpha": {"rate.w1": None}}, "alpha rate.w1 is missing"),
    ("meta-curvature", {"alpha": {"rate.w1": torch.ones(1, 3)}}, "alpha rate.w1 is (steps, 3)"),
    ("meta-curvature", {"alpha": {"beta3": torch.ones(10)}}, "alpha beta3 is (10), expected missing"),
    ("meta-curvature", {"theta": {"w1": None}}, "theta w1 is missing"),
    ("meta-curvature", {"theta": {"w1": torch.ones(4, 4)}}, "theta w1 is (4, 4)"),
    ("meta-curvature", {"encoder": {"in.w": torch.ones(2)}}, "encoder in.w is (2)"),
    ("meta-sgd", {"app": ["brdf"]}, ""),
    ("meta-sgd", {"checkpoint": ["meta-sgd"]}, ""),
    ("meta-sgd", {"checkpoint": None}, ""),
]


def test_checkpoints_of_other_fits_are_one_line(fit: Callable, network: Path) -> None:
    for rule, changes, message in CHECKPOINTS:
        line = fit("meta", network, "--rule", rule, "--checkpoint", write_changed_checkpoint(rule, changes)).error
        assert message in line, changes
        assert "s.safetensors" in line, changes
    for name in ("texture/quick", "illumination/quick", "brdf/few"):
        assert fit("meta", network, "--checkpoint", SHIPPED / f"{name}.safetensors").error


# Shards


def test_tensors_missing_from_a_shard_are_named_by_check_and_fits(
    metapp: Callable, fit: Callable, network: Path
) -> None:
    metapp("data", "nbrdf", network, "--out", "set", "--samples", "512", "--split", "test")
    (file,) = Path("set").glob("*.safetensors")
    save_file({key: value for key, value in load_file(file).items() if key != "reflectance"}, file)
    for message in (metapp("data", "check", "set").err, fit("overfit", "--data", "set").error):
        assert "'reflectance' is missing" in message
        assert file.name in message
    manifest = Path("set/manifest.json")
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"app": "../brdf"}))
    assert metapp("data", "check", "set").error

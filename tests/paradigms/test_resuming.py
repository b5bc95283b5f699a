"""Trainings that are cut off: what goes on from a training checkpoint ends bit for bit as an uninterrupted one."""

import errno
import math
import random
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Recipe
from metapp.learning.task import Tasks
from metapp.paradigms import PARADIGMS
from metapp.paradigms.training import TrainState, train_phi
from metapp.paradigms.trainings import Training, general_training, rule_training, trainings_of
from metapp.storage.checkpoint_files import load_training_state, save_training_state, write_entry
from tests.marked import long
from tests.paradigms.small import OWN_RULES, seeded_generator

ONE_APP = pytest.mark.parametrize("app", ["brdf"], indirect=True)  # what no application changes
SETTINGS = {"steps": 12, "seed": 3}
SEARCHED: Any = ([{"rate": 0.5}, {"rate": 2.0}], [{"beta1": 0.3}, {"eps": 1e-3, "rate": 1.2}])


class Cut(Exception):
    """A kill: what was not written before is lost."""


@pytest.fixture
def training(kind: str, app: App, recipe: Recipe) -> Training:
    """The training of a checkpoint: general, quickft, or a rule, the Adam of which may be tuned first."""
    recipe = replace(recipe, search=SEARCHED)
    if kind in PARADIGMS:
        return trainings_of(kind, app, recipe)[-1]
    rule, tuned = (kind.removesuffix(" tuned"), kind.endswith(" tuned"))
    rule = rule if rule in recipe.meta else "meta-encoder"  # networks are for grids alone
    settings = replace(recipe.meta[rule], searches_adam=tuned, initialisation="encoder" if tuned else "mean")
    return rule_training(app, replace(recipe, meta={rule: settings}), rule)


def run(training: Training, tasks: Tasks, path: Path | None = None, most: float = math.inf) -> TrainState:
    """Train, from the training checkpoint `path` if there is one, and write that each time; `most` yields kill it."""
    app = training.app
    general = MetaParameters(encoder=app.init_encoder(seeded_generator(2))) if training.begins_at_general else None
    fields = load_training_state(path, SETTINGS) if path else None
    since = TrainState(**fields) if fields else None
    for count, state in enumerate(train_phi(training, tasks, seeded_generator(3), general=general, since=since), 1):
        if path:
            save_training_state(path, state._asdict(), SETTINGS)
        if count >= most:
            raise Cut(state)
    return state


def as_file(prepared: TrainState, path: Path) -> bytes:
    """All of a training's result, as its file holds it."""
    write_entry(
        path, "a", prepared.phi, {"curve": prepared.curve, "at": prepared.best_step, "error": prepared.validation}
    )
    return path.read_bytes()


# each kind of stages on the fastest application, and each application's own rule with all stages that there are
KINDS = [("brdf", kind) for kind in ("general", "quickft", "meta-sgd", "meta-encoder")] + [
    long("brdf", "meta-basis tuned")
]
OWN_KINDS = [long(app, f"{rule} tuned") for app, rule in OWN_RULES.items()]


@pytest.mark.parametrize(("app", "kind"), KINDS + OWN_KINDS, indirect=["app"])
def test_interrupted_trainings_end_as_uninterrupted_ones(
    kind: str, training: Training, tasks: Tasks, tmp_path: Path
) -> None:
    expected = as_file(run(training, tasks), tmp_path / "expected.safetensors")
    path, chance, cuts = tmp_path / "training.safetensors", random.Random(kind), 0
    while True:
        try:
            result = run(training, tasks, path, most=chance.randint(1, 3))
            break
        except Cut:
            cuts += 1
    assert cuts > 1
    assert as_file(result, tmp_path / "made.safetensors") == expected


@pytest.mark.parametrize(
    ("app", "kind"),
    [("brdf", "general"), ("brdf", "quickft"), ("brdf", "meta-encoder tuned"), long("illumination", "meta-lgd tuned")],
    indirect=["app"],
)
def test_ctrl_c_at_any_moment_loses_no_step(
    kind: str, training: Training, tasks: Tasks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signals come in the middle of an outer step or a validation; the checkpoint holds a state between two steps."""
    expected = as_file(run(training, tasks), tmp_path / "expected.safetensors")
    path, chance, reached = tmp_path / "training.safetensors", random.Random(kind), [(False, -1)]
    of = type(training.app)
    augment, errors, calls = of.augment, of.errors, [0]

    def interrupting(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            result = function(*arguments)
            calls[0] -= 1
            if calls[0] == 0:
                raise KeyboardInterrupt
            return result

        return call

    for _ in range(100):
        calls[0] = chance.randint(2, 5)
        with monkeypatch.context() as patch:
            patch.setattr(of, "augment", interrupting(augment))
            patch.setattr(of, "errors", interrupting(errors))
            try:
                results = run(training, tasks, path)
                break
            except KeyboardInterrupt:
                if fields := load_training_state(path, SETTINGS):
                    reached.append((bool(fields["moments"]), fields["step"]))
    assert as_file(results, tmp_path / "made.safetensors") == expected
    assert len(reached) > 1  # it was cut off
    assert reached == sorted(reached)


@pytest.fixture
def cut(app: App, recipe: Recipe, tasks: Tasks, tmp_path: Path) -> Path:
    """A training checkpoint of a General."""
    path = tmp_path / "general.training.safetensors"
    with pytest.raises(Cut):
        run(general_training(app, recipe), tasks, path, most=4)
    return path


@ONE_APP
def test_layouts_and_types_are_kept(cut: Path) -> None:
    fields = load_training_state(cut, SETTINGS)
    assert fields is not None
    turned = torch.arange(6.0).reshape(2, 3).T
    current = {"b": turned, "a": torch.ones(2, dtype=torch.float64)}
    state = TrainState(**fields)._replace(searched=(0.5, math.inf), current=current)
    save_training_state(cut, state._asdict(), SETTINGS)
    again = load_training_state(cut, SETTINGS)
    assert again is not None
    assert again.keys() == fields.keys()
    found = again["current"]
    assert again["searched"] == (0.5, math.inf)
    assert again["curve"] == state.curve
    assert list(found) == ["b", "a"]
    assert found["b"].stride() == turned.stride()
    assert torch.equal(found["b"], turned)
    assert found["a"].dtype == torch.float64


@ONE_APP
def test_a_checkpoint_of_other_settings_is_put_aside(cut: Path) -> None:
    before, others = cut.read_bytes(), {**SETTINGS, "seed": 4, "more": 1}
    with pytest.raises(ValueError, match=r"other settings \(more, seed\), put aside as general.training.aside"):
        load_training_state(cut, others)
    assert cut.with_name("general.training.aside.safetensors").read_bytes() == before
    assert load_training_state(cut, others) is None


def damaged(raw: bytes) -> list[bytes]:
    """Cut short, of another kind, and with single bits turned: in the header, in its document, in tensors."""
    size = struct.unpack("<Q", raw[:8])[0]
    places = [2, 9, size // 2, size, 8 + size + 3, (len(raw) + size) // 2, len(raw) - 1]
    flipped = [raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :] for at in places]
    return [b"", raw[:100], raw[:-1], raw + b"0", b"{}" * 50, *flipped]


@ONE_APP
def test_a_damaged_checkpoint_is_one_line(cut: Path) -> None:
    raw = cut.read_bytes()
    for content in damaged(raw):
        cut.write_bytes(content)
        with pytest.raises(ValueError, match="a damaged training checkpoint, put aside"):
            load_training_state(cut, SETTINGS)
    cut.write_bytes(raw)
    assert load_training_state(cut, SETTINGS) is not None


@ONE_APP
def test_a_full_disk_ends_no_training(
    cut: Path,
    app: App,
    recipe: Recipe,
    tasks: Tasks,
    monkeypatch: pytest.MonkeyPatch,
    recwarn: pytest.WarningsRecorder,
) -> None:
    training = general_training(app, recipe)
    before, expected = cut.read_bytes(), as_file(run(training, tasks), cut.with_name("expected"))

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        result = run(training, tasks, cut)
    assert f"{cut.parent}: No space left on device; {cut.name} was not written" in str(recwarn[0].message)
    assert cut.read_bytes() == before
    assert as_file(result, cut.with_name("made")) == expected

"""Preparations that are cut off: what goes on from a training checkpoint ends bit for bit as an uninterrupted one."""

from __future__ import annotations

import errno
import random
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from metapp.learning.learn import MetaParameters
from metapp.learning.progress import TrainState
from metapp.learning.task import Tasks
from metapp.paradigms import Paradigm, tuning
from metapp.paradigms.meta import Meta
from metapp.paradigms.paradigm import TrainingData
from metapp.paradigms.validation import split_validation
from metapp.storage.checkpoints import save_checkpoint
from metapp.storage.training_checkpoint import TrainingCheckpoint
from tests.marked import long
from tests.paradigms.small import OWN_RULES, rng, untrained

ONE_APP = pytest.mark.parametrize("app", ["brdf"], indirect=True)  # what no application changes
SETTINGS = {"steps": 12, "seed": 3}
SEARCHED: Any = ([{"rate": 0.5}, {"rate": 2.0}], [{"beta1": 0.3}, {"eps": 1e-3, "rate": 1.2}])


class Cut(Exception):
    """A kill: what was not written before is lost."""


class Cutting(TrainingCheckpoint):
    """Writes every time, and ends the program after so many."""

    def __init__(self, start: Path, after: float) -> None:
        super().__init__(start, SETTINGS)
        self.seconds, self.after, self.steps = 0.0, after, []

    def keep(self, progress: TrainState) -> None:
        super().keep(progress)
        self.steps.append(progress.outer.step if progress.outer else -len(progress.errors))
        if len(self.steps) >= self.after:
            raise Cut


@pytest.fixture
def trained(kind: str, fits: dict[str, Paradigm], monkeypatch: pytest.MonkeyPatch) -> Paradigm:
    """What prepares a checkpoint: general, quickft, or a rule, the Adam of which may be tuned first."""
    monkeypatch.setattr(tuning, "SEARCHED", SEARCHED)
    if kind in fits:
        return fits[kind]
    recipe = fits["meta"].recipe
    rule, tuned = (kind.removesuffix(" tuned"), kind.endswith(" tuned"))
    rule = rule if rule in recipe.meta else "meta-encoder"  # networks are for grids alone
    training = replace(recipe.meta[rule], tuned=tuned, initialisation="encoder" if tuned else "mean")
    return Meta(fits["meta"].app, replace(recipe, meta={rule: training}), rule)


def run(paradigm: Paradigm, tasks: Tasks, checkpoint: TrainingCheckpoint | None = None) -> TrainState:
    encoder = MetaParameters(encoder=untrained(paradigm).encoder)
    options: dict[str, Any] = {"encoder": None if paradigm.name == "general" else encoder}
    if checkpoint is not None:
        options["since"] = checkpoint.load()
    for progress in paradigm.prepare(TrainingData(*split_validation(tasks), rng(3), **options)):
        if checkpoint is not None:
            checkpoint.keep(progress)
    return progress


def as_file(prepared: TrainState, path: Path) -> bytes:
    """All of a preparation's result, as its file holds it."""
    save_checkpoint(
        path, prepared.phi, {"curve": prepared.curve, "at": prepared.best_step, "error": prepared.validation}
    )
    return path.read_bytes()


# each kind of stages on the fastest application, and each application's own rule with all stages that there are
KINDS = [("brdf", kind) for kind in ("general", "quickft", "meta-sgd", "meta-encoder")] + [
    long("brdf", "meta-basis tuned")
]
OWN_KINDS = [long(app, f"{rule} tuned") for app, rule in OWN_RULES.items()]


@pytest.mark.parametrize(("app", "kind"), KINDS + OWN_KINDS, indirect=["app"])
def test_what_was_cut_off_ends_as_if_it_had_not_been(
    kind: str, trained: Paradigm, tasks: Tasks, tmp_path: Path
) -> None:
    expected = as_file(run(trained, tasks), tmp_path / "expected.safetensors")
    path, chance, seen = tmp_path / "start.safetensors", random.Random(kind), [0]
    while True:
        checkpoint = Cutting(path, after=chance.randint(1, 3))
        try:
            made = run(trained, tasks, checkpoint)
            break
        except Cut:
            seen += checkpoint.steps
    assert len(seen) > 3  # it was cut off
    assert as_file(made, path) == expected


@pytest.mark.parametrize(
    ("app", "kind"),
    [("brdf", "general"), ("brdf", "quickft"), ("brdf", "meta-encoder tuned"), long("illumination", "meta-lgd tuned")],
    indirect=["app"],
)
def test_ctrl_c_at_any_moment_loses_no_step(
    kind: str, trained: Paradigm, tasks: Tasks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of an outer step or of a validation, as signals come; what is written is of between two."""
    expected = as_file(run(trained, tasks), tmp_path / "expected.safetensors")
    path, chance, reached = tmp_path / "start.safetensors", random.Random(kind), [(-1, -1)]
    of = type(trained.app)
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
        checkpoint = TrainingCheckpoint(path, SETTINGS)
        with monkeypatch.context() as patch:
            patch.setattr(of, "augment", interrupting(augment))
            patch.setattr(of, "errors", interrupting(errors))
            try:
                made = run(trained, tasks, checkpoint)
                break
            except KeyboardInterrupt:
                checkpoint.write()
                now = checkpoint.state
                reached.append((len(now.errors), now.outer.step if now.outer else -1))
    assert as_file(made, path) == expected
    assert len(reached) > 1  # it was cut off
    assert reached == sorted(reached)


@pytest.fixture
def cut(fits: dict[str, Paradigm], tasks: Tasks, tmp_path: Path) -> Path:
    """A training checkpoint of a General."""
    checkpoint = Cutting(tmp_path / "general.safetensors", after=4)
    with pytest.raises(Cut):
        run(fits["general"], tasks, checkpoint)
    return checkpoint.path


def reopened(cut: Path, **more: Any) -> TrainingCheckpoint:
    return TrainingCheckpoint(cut.with_name("general.safetensors"), {**SETTINGS, **more})


@ONE_APP
def test_layouts_and_types_are_kept(cut: Path) -> None:
    checkpoint = reopened(cut)
    progress = checkpoint.load()
    assert progress.outer is not None
    turned = torch.arange(6.0).reshape(2, 3).T
    theta = {"b": turned, "a": torch.ones(2, dtype=torch.float64)}
    outer = progress.outer._replace(theta=theta)
    checkpoint.keep(progress._replace(errors=(0.5, float("inf")), outer=outer))
    checkpoint.write()
    again = checkpoint.load()
    assert again.errors == (0.5, float("inf"))
    assert again.outer is not None
    found = again.outer.theta
    assert list(found) == ["b", "a"]
    assert found["b"].stride() == turned.stride()
    assert torch.equal(found["b"], turned)
    assert found["a"].dtype == torch.float64


@ONE_APP
def test_a_checkpoint_of_other_settings_is_put_aside(cut: Path) -> None:
    before = cut.read_bytes()
    other = reopened(cut, seed=4, more=1)
    with pytest.raises(ValueError, match=r"other settings \(more, seed\), put aside as general.training.aside"):
        other.load()
    assert cut.with_name("general.training.aside.safetensors").read_bytes() == before
    assert other.load() == TrainState()


def damaged(raw: bytes) -> list[bytes]:
    """Cut short, of another kind, and with single bits turned: in the header, in its document, in tensors."""
    size = struct.unpack("<Q", raw[:8])[0]
    places = [2, 9, size // 2, size, 8 + size + 3, (len(raw) + size) // 2, len(raw) - 1]
    flipped = [raw[:at] + bytes([raw[at] ^ 4]) + raw[at + 1 :] for at in places]
    return [b"", raw[:100], raw[:-1], raw + b"0", b"{}" * 50, *flipped]


@ONE_APP
def test_a_damaged_checkpoint_is_one_line(cut: Path) -> None:
    raw = cut.read_bytes()
    for each in damaged(raw):
        cut.write_bytes(each)
        with pytest.raises(ValueError, match="a damaged training checkpoint, put aside"):
            reopened(cut).load()
    cut.write_bytes(raw)
    assert reopened(cut).load().outer is not None


@ONE_APP
def test_a_full_disk_ends_no_training(
    cut: Path,
    fits: dict[str, Paradigm],
    tasks: Tasks,
    monkeypatch: pytest.MonkeyPatch,
    recwarn: pytest.WarningsRecorder,
) -> None:
    before, expected = cut.read_bytes(), as_file(run(fits["general"], tasks), cut.with_name("expected"))

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    checkpoint = reopened(cut)
    checkpoint.seconds = 0.0
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        made = run(fits["general"], tasks, checkpoint)
    assert f"{cut.parent}: No space left on device; {cut.name} was not written" in str(recwarn[0].message)
    assert cut.read_bytes() == before
    assert as_file(made, cut.with_name("made")) == expected


def test_seconds_of_a_training_outlive_a_kill(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr("metapp.storage.training_checkpoint.time.process_time", lambda: clock[0])
    first = TrainingCheckpoint(tmp_path / "meta-sgd.safetensors", {})
    clock[0] += 7
    assert first.spent == 7
    first.state = first.state._replace(errors=(1.0,))
    first.write()
    clock[0] += 1000
    second = TrainingCheckpoint(tmp_path / "meta-sgd.safetensors", {})
    assert second.load().errors == (1.0,)
    clock[0] += 5
    assert second.spent == 12

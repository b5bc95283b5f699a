"""The record of a fit: its figures, and the settings that they depend on, as `record.json` holds them.

A record may have been written by anybody: :func:`decode_record` refuses what is none in one line.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import msgspec

from metapp.storage import Document
from metapp.storage.files import to_json_value


class Origin(msgspec.Struct, frozen=True):
    """The places by which a later command finds again what was fitted.

    Attributes:
        inputs: absolute paths of the inputs, as a user gave them.
        data: the absolute path of the data set; "" for none.
    """

    inputs: list[str] = []
    data: str = ""


class Settings(msgspec.Struct, kw_only=True):
    """All that the error and the seconds of a fit depend on.

    Attributes:
        app: the name of the application.
        observe: what the fit sees, a value of --observe; "" if all fits of the application see the same.
        paradigm: the name of the paradigm; "" for a method without a network.
        rule: the name of the learned rule, "adam" or "none".
        steps: the number of gradient steps.
        batch: the number of samples that a step sees.
        adam: the settings of the Adam of the steps; None if the rule is a learned one.
        guard: the settings of the guard of a learned rule.
        checkpoint: 12 hexadecimal digits of the checkpoint's content; "" for none.
        data: the label of the data set, "files" for files.
        recipe: the name of the recipe.
        options: the application's own options that differ from their default.
        seed: the random seed.
        device: the device of the tensors.
        versions: the versions of packages by name.
        further: further settings by name: conditions that errors of the application depend on, and settings of records
            that are no fits by a paradigm. In JSON they stand beside the others.
    """

    app: str = ""
    observe: str = ""
    paradigm: str = ""
    rule: str = ""
    steps: int | None = None
    batch: int | None = None
    adam: dict[str, Any] | None = None
    guard: dict[str, Any] | None = None
    checkpoint: str = ""
    data: str = ""
    recipe: str = ""
    options: dict[str, Any] = {}
    seed: int | None = None
    device: str = ""
    versions: dict[str, Any] = {}
    further: dict[str, Any] = {}

    @classmethod
    def of(cls, entries: Mapping[str, Any]) -> Settings:
        """Return settings of entries by name, of which some may be further ones.

        >>> Settings.of({"app": "brdf", "steps": 10, "precision": "float32"}).further
        {'precision': 'float32'}
        """
        return msgspec.convert(to_json_value(_set_further_apart(entries)), cls)

    def document(self) -> Document:
        """Return the settings as JSON holds them: those that are set, further ones beside the others."""
        return _entries_that_are_set(self, leave_out=("further",)) | self.further


def _set_further_apart(entries: Mapping[str, Any]) -> Document:
    """Return settings by name with those that `Settings` has no field for in an entry `further`; None is not set."""
    names = set(Settings.__struct_fields__) - {"further"}
    known = {name: value for name, value in entries.items() if name in names and value is not None}
    return known | {"further": {name: value for name, value in entries.items() if name not in names}}


class FitRecord(msgspec.Struct, kw_only=True):
    """The record of a fit.

    Attributes:
        name: the name of the task.
        error: the error in the unit of tables; None if the task holds no reference.
        scale: the factor by which `error` was multiplied; `errors` have their own units.
        photo_error: the mean difference between the fit and its photographs in percent of display values; None if the
            error says more, or the fit saw no photograph.
        errors: further errors by name.
        seconds: the time of inference in seconds; None for an answer that was made elsewhere.
        cpu_seconds: the CPU time of inference in seconds; None where a GPU computed.
        threads: the number of threads; figures differ in their last digits by it.
        counts: how many things of a kind the fit saw.
        note: what is said of the fit, in a clause.
        guarded: whether the guard of a learned rule acted; None if there was no guard.
        warning: clauses that doubt the fit, joined by "; ".
        batch: the number of tasks that were fitted together, whose seconds are shares.
        figures: further figures by name, which the application or the method names.
        source: the place of the input, or the name of the task in a data set.
        content: a digest of the task's values.
        origin: the places of what was fitted.
        settings: all that the error and the seconds depend on.
        folder: the folder of the fit, or its file; it is not stored.

    >>> FitRecord(name="gold", error=1.5).document()
    {'name': 'gold', 'error': 1.5, 'settings': {}}
    """

    name: str
    error: float | None
    scale: float | None = None
    photo_error: float | None = None
    errors: dict[str, float | None] = {}
    seconds: float | None = None
    cpu_seconds: float | None = None
    threads: int | None = None
    counts: dict[str, int] = {}
    note: str = ""
    guarded: bool | None = None
    warning: str = ""
    batch: int = 1
    figures: dict[str, Any] = {}
    source: str = ""
    content: str = ""
    origin: Origin = Origin()
    settings: Settings = msgspec.field(default_factory=Settings)
    folder: str = ""

    def document(self) -> Document:
        """Return the record as JSON holds it, without the entries that are not set; an unknown error is None."""
        entries = _entries_that_are_set(self, leave_out=("folder", "batch", "settings", "origin"))
        document = {"name": self.name, "error": self.error, **entries}
        document |= {"batch": self.batch} if self.batch > 1 else {}
        document |= {"origin": origin} if (origin := _entries_that_are_set(self.origin)) else {}
        return document | {"settings": self.settings.document()}

    def has_settings(self, settings: Settings) -> bool:
        """Test whether the record states these settings, as far as JSON can hold them."""
        return self.settings == Settings.of(settings.document())


def _entries_that_are_set(struct: msgspec.Struct, leave_out: Collection[str] = ()) -> Document:
    """Return the fields of a structure by name, without those that are None or empty."""
    values = {name: getattr(struct, name) for name in struct.__struct_fields__ if name not in leave_out}
    return {name: value for name, value in values.items() if value is not None and value not in ("", {}, [])}


def encode_record(record: FitRecord) -> bytes:
    """Return a record as JSON; numbers that are not finite, which JSON lacks, become None."""
    return json.dumps(to_json_value(record.document()), allow_nan=False, indent=1).encode()


def decode_record(stored: bytes | str, *, figures: Collection[str] = (), timed: bool = False) -> FitRecord:
    """Read a record from JSON, which anybody may have written.

    Args:
        stored: the JSON document.
        figures: the names of figures that the record must have.
        timed: whether it must have seconds.

    Raises:
        ValueError: it is no record, or lacks one of these; the message says what is wrong.

    >>> decode_record('{"name": "gold", "error": 1.5, "settings": {"precision": "half"}}').settings.further
    {'precision': 'half'}
    """
    try:
        document = msgspec.json.decode(stored)
        if isinstance(document, dict) and isinstance(document.get("settings"), dict):
            document["settings"] = _set_further_apart(document["settings"])
        record = msgspec.convert(document, FitRecord)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(f"no record: {error}") from None
    if missing := [name for name in figures if name not in record.figures]:
        raise ValueError(f"no record: without {', '.join(missing)}")
    if timed and record.seconds is None:
        raise ValueError("no record: without seconds")
    record.source = record.source or record.name
    return record


def summary(records: Sequence[FitRecord]) -> dict[str, float | None]:
    """Summarise records: the mean error in the unit of tables, and the median inference time of a task in seconds.

    Records without an error or a time are left out. Fits of photos without a reference have the mean of `photo_error`,
    too.

    >>> summary([FitRecord(name="a", error=1.0, seconds=0.5), FitRecord(name="b", error=3.0, seconds=0.7)])
    {'error': 2.0, 'seconds': 0.6}
    """
    photo_errors = [record.photo_error for record in records if record.photo_error is not None]
    errors = [record.error for record in records if record.error is not None]
    seconds = [record.seconds for record in records if record.seconds is not None]
    return {
        "error": statistics.fmean(errors) if errors else None,
        **({"photo_error": statistics.fmean(photo_errors)} if photo_errors else {}),
        "seconds": statistics.median(seconds) if seconds else None,
    }


def count_guarded(records: Sequence[FitRecord]) -> int | None:
    """Count the tasks on which the guard of a learned rule acted; None if the fits had no guard.

    >>> count_guarded([FitRecord(name="a", error=1.0, guarded=True), FitRecord(name="b", error=1.0, guarded=False)])
    1
    """
    flags = [record.guarded for record in records if record.guarded is not None]
    return sum(flags) if flags else None

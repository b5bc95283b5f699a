"""Records of fits as JSON holds them, and records that earlier versions wrote.

Anybody may have written a record that is read here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from metapp.runs.spec import Spec
from metapp.storage import Document

_SPEC_KEYS = {field.name for field in fields(Spec)}
# settings that earlier versions wrote beside the recipe that they follow from
_SETTINGS_OF_RECIPES = ("batch", "adam", "guard")
_RULES_THAT_ARE_NOT_LEARNED = ("adam", "none")


def convert_record(document: Mapping[str, Any]) -> Document:
    """Return a record with the entries of this version, of one that any version wrote.

    Earlier versions kept the digest of the checkpoint as `checkpoint`, conditions of errors beside other settings, and
    the places of inputs as `origin`.

    >>> settings = {"app": "brdf", "paradigm": "general", "rule": "none", "batch": 512, "checkpoint": "1a2b"}
    >>> convert_record({"name": "gold", "settings": settings})["settings"]
    {'app': 'brdf', 'paradigm': 'general', 'digest': '1a2b'}
    """
    record, settings = dict(document), document.get("settings")
    if not isinstance(settings, Mapping) or settings.keys() <= _SPEC_KEYS:
        return record
    kept = {key: value for key, value in settings.items() if key in _SPEC_KEYS - {"checkpoint"}}
    if kept.get("rule") in _RULES_THAT_ARE_NOT_LEARNED:
        del kept["rule"]
    kept.setdefault("paradigm", "")
    kept |= {"digest": settings["checkpoint"]} if settings.get("checkpoint") else {}
    known = {*_SPEC_KEYS, *_SETTINGS_OF_RECIPES}
    conditions = {key: value for key, value in settings.items() if key not in known}
    record["settings"] = kept | ({"conditions": conditions} if conditions else {})
    origin = record.pop("origin", {})
    if isinstance(origin, Mapping):
        record["inputs"] = [*origin.get("inputs", ()), *([origin["data"]] if origin.get("data") else [])]
    return record

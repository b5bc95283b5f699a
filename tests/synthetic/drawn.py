"""Synthetic sets that several test files look at, drawn once a process."""

from __future__ import annotations

import functools
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

from metapp.learning.task import Task

TRAIN = {"texture": 100, "svbrdf_stationary": 64, "svbrdf_nonstationary": 48, "illumination": 48}  # tasks for training


class Drawn(NamedTuple):
    """A module of `data_tools.synthetic` and tasks of it: some for training, all for testing."""

    source: ModuleType
    train: list[Task]
    test: list[Task]

    @property
    def tasks(self) -> list[Task]:
        return self.train + self.test


def source_of(app: str) -> ModuleType:
    """The module that draws them."""
    return import_module(f"data_tools.synthetic.{app}")


@functools.cache
def drawn(app: str) -> Drawn:
    """The set of an application with images or maps."""
    source = source_of(app)
    sets = (source.synthetic_tasks("train", TRAIN[app]), source.synthetic_tasks("test", source.COUNTS["test"]))
    return Drawn(source, *map(list, sets))

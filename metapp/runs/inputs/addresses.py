"""Inputs and runs at addresses, such as s3://bucket/gold.binary, which an extension reads and writes."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from metapp import door
from metapp.runs.requests.request import Request


def at_address(path: Path) -> Any:
    """The module that reads and writes at a path that is an address; None for other paths."""
    if ":/" not in str(path):  # of thousands of paths
        return None
    modules = (door.module_of(offer.module) for offer in door.offers(door.Addresses))
    return next((module for module in modules if module.address_of(path)), None)


def place_of(path: Path) -> str:
    """What records know a path by: its address, or that of what it is a copy of, else the whole path."""
    remote = at_address(path)
    return remote.address_of(path) if remote else str(path.resolve())


def local(paths: Iterable[Path]) -> list[Path]:
    """Paths, with copies of what is at addresses."""
    both = ((path, at_address(path)) for path in paths)
    return [copy for path, remote in both for copy in (remote.copies_of(path) if remote else [path])]


def kept(folder: Path, request: Request) -> AbstractContextManager[None]:
    """Get a run's folder from its address, and put there what is new at the end; of other folders nothing."""
    remote = at_address(folder)
    return remote.kept(folder, request) if remote else nullcontext()

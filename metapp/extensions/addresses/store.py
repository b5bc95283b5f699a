"""Connections to object stores and servers by fsspec, and what goes wrong there in one line."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from pathlib import PurePosixPath
from typing import Any, NamedTuple

# the protocols of addresses, and the package that fsspec needs for each; others could read more than one file
PROTOCOLS = {
    **dict.fromkeys(("s3", "s3a"), "s3fs"),
    **dict.fromkeys(("gs", "gcs"), "gcsfs"),
    **dict.fromkeys(("az", "abfs", "abfss"), "adlfs"),
    **dict.fromkeys(("http", "https"), "aiohttp"),
    **dict.fromkeys(("hdfs",), "pyarrow"),
    "memory": "fsspec",
}


class Place(NamedTuple):
    """An address, and by what it is read.

    Attributes:
        address: as users give it.
        files: the file system of fsspec.
        name: what that calls it.
    """

    address: str
    files: Any
    name: str

    @property
    def scheme(self) -> str:
        """The protocol."""
        return self.address.partition("://")[0]

    def address_of(self, name: str) -> str:
        """The address of a name that the file system gave."""
        rest = name.partition("://")[2] if "://" in name else name
        return f"{self.scheme}://{rest.lstrip('/')}"

    def relative(self, name: str) -> PurePosixPath:
        """A name that the file system gave, as a path below this place.

        Raises:
            OSError: it would lead elsewhere.
        """
        path = PurePosixPath(name.removeprefix(self.name).lstrip("/"))
        if ".." in path.parts or "\0" in name:
            raise OSError(f"a name that leads out of its folder: {ascii(name)[:80]}")
        return path


def opened(address: str) -> Place:
    """Connect to where an address is; nothing is read yet.

    Raises:
        ValueError: the protocol or the package for it is missing.
    """
    scheme = address.partition("://")[0]
    if scheme not in PROTOCOLS or "::" in address:
        known = ", ".join(f"{name}://" for name in PROTOCOLS)
        raise ValueError(f"{address}: no address that metapp reads, expected a path or one of {known}...")
    missing = [name for name in dict.fromkeys(("fsspec", PROTOCOLS[scheme])) if not importlib.util.find_spec(name)]
    if missing:
        packages = " ".join(missing)
        raise ValueError(f"{address}: needs the package{'s' * (len(missing) > 1)} {packages}: pip install {packages}")
    import fsspec

    with told(address):
        files, name = fsspec.core.url_to_fs(address)
    return Place(address, files, name)


@contextlib.contextmanager
def told(address: str) -> Iterator[None]:
    """What an object store refuses becomes one line that names the address.

    Raises:
        ValueError: no such object, no access, or anything else that the file system reports.
    """
    try:
        yield
    except FileNotFoundError:
        raise ValueError(f"{address}: no such object or folder, expected an existing one.") from None
    except Exception as error:  # each file system has classes of its own
        if isinstance(error, PermissionError) or "redential" in type(error).__name__ + str(error):
            reason = f"access denied ({_first_line(error)})"
            raise ValueError(f"{address}: {reason}; set the credentials of {address.partition(':')[0]}.") from None
        raise ValueError(
            f"{address}: {type(error).__name__}: {_first_line(error)}; check the address and the network."
        ) from None


def _first_line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), "no reason given")[:200].rstrip(".")

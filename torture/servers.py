"""The page of a fit that runs, among random clients: the fit goes on, memory and threads stay, the page is served."""

from __future__ import annotations

import contextlib
import http.client
import json
import random
import re
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

from torture import commands, kills
from torture.commands import metapp
from torture.mutate import mutate_bytes
from torture.report import Report

HOST = "127.0.0.1"
FITS, QUICK_FITS = 8, 1
STEPS = 16_000  # a fit of 10 s or more, which must outlast the clients
CLIENTS, SECONDS = 300, 3.0  # of one fit
AFTERWARDS = 7.0  # seconds until idle connections have ended
THREADS, MEMORY = 18, 96 * 2**20  # more than without clients: one a connection, and bytes


def run(report: Report, seed: str, quick: bool, only: list[str], ends: float = float("inf")) -> None:
    """Watch fits among clients; see `torture.kills.run`."""
    place = Path(tempfile.mkdtemp(prefix="torture-servers-"))
    try:
        data = place / "data"
        commands.run(report, "servers:data", metapp("data", "synth", "brdf", "--count", "6", "--out", data), (0,))
        expected, usual = _watched(report, data, place / "alone", None)
        for index in range(QUICK_FITS if quick else FITS):
            if time.monotonic() < ends:
                found, used = _watched(report, data, place / str(index), random.Random(f"{seed}/servers/{index}"))
                again = f"python -m torture --seed {seed} servers, fit {index}"
                for fault in kills.differences(expected, found):
                    report.add("servers", f"{fault} among clients", again)
                if used[0] > usual[0] + THREADS or used[1] > usual[1] + MEMORY:
                    report.add("servers", f"{used[0]} threads and {used[1] >> 20} MiB, alone {usual}", again)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _watched(
    report: Report, data: Path, out: Path, rng: random.Random | None
) -> tuple[dict[str, Any], tuple[int, int]]:
    """A watched fit, among clients where there are draws: its results, and its most threads and bytes."""
    command = metapp("overfit", "brdf", "--steps", STEPS, "--watch", "--data", data, "--out", out, "-q")
    process = commands.start([str(word) for word in command])
    assert process.stdout
    line = process.stdout.readline().decode()
    address, most = re.search(r"http://127\.0\.0\.1:\d+/\S+/", line), [0, 0]
    watching = threading.Thread(target=_measure, args=(process.pid, most), daemon=True)
    watching.start()
    if not address:
        report.add("servers", f"no address: {line!a}", commands.shown(command))
    elif rng:
        _attack(report, rng, address[0])
    try:
        output = line + process.communicate(timeout=commands.SECONDS)[0].decode("utf-8", "replace")
    except commands.subprocess.TimeoutExpired:
        process.kill()
        output = process.communicate()[0].decode("utf-8", "replace")
    watching.join()
    commands.check(report, "servers", command, commands.Ended(process.returncode, output), (0,))
    if len(output.splitlines()) != 1:
        report.add("servers", f"printed {output[:300]!a}", commands.shown(command))
    return kills.results(out), (most[0], most[1])


def _measure(pid: int, most: list[int]) -> None:
    """Keep the most threads and resident bytes of a process until it ends."""
    with contextlib.suppress(OSError, IndexError):
        while True:
            state = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
            if "VmRSS" not in state:
                return
            most[:] = max(most[0], int(state["Threads"])), max(most[1], int(state["VmRSS"].split()[0]) << 10)
            time.sleep(0.05)


def _attack(report: Report, rng: random.Random, address: str) -> None:
    """Have clients for a while, and then look at the page."""
    draws, ends = [rng.randrange(2**32) for _ in range(CLIENTS)], time.monotonic() + SECONDS
    threads = [threading.Thread(target=_be_a_client, args=(random.Random(draw), address, ends)) for draw in draws]
    for thread in threads:
        thread.start()
        time.sleep(SECONDS / CLIENTS / 2 * (rng.random() < 0.9))
    for thread in threads:
        thread.join()
    report.count("servers:clients", CLIENTS)
    ends, reason = time.monotonic() + AFTERWARDS, ""
    while time.monotonic() < ends:
        try:
            with urlopen(address, timeout=5) as page, urlopen(f"{address}news?after=0", timeout=5) as news:
                whole = '"live": "news"' in page.read().decode() and json.loads(news.read())["serial"] > 0
                reason = "" if whole else "another page"
                break
        except (OSError, ValueError, http.client.HTTPException) as error:
            reason = f"{type(error).__name__}: {error}"
            time.sleep(0.2)
    if reason:
        report.add("servers", f"no page after the clients: {reason}", f"clients {draws[:3]} and so on")


def _be_a_client(rng: random.Random, address: str, ends: float) -> None:
    """Connect once and be idle, slow, huge, senseless or gone, or ask for odd things by the right token."""
    where = urlsplit(address)
    client = rng.choice(CLIENT)
    with contextlib.suppress(OSError), socket.create_connection((HOST, where.port or 0), timeout=1) as connection:
        for part in client(rng, where.path, f"Host: {where.netloc}\r\n"):
            connection.sendall(part)
            time.sleep(rng.choice((0, 0, 0.05)))
            if time.monotonic() > ends:
                return
        if rng.random() < 0.3:
            connection.shutdown(socket.SHUT_WR)
        connection.settimeout(max(0.01, (ends - time.monotonic()) * rng.random()))
        while rng.random() < 0.9 and connection.recv(rng.choice((1, 4096))):
            pass


def _slow(rng: random.Random, path: str, host: str) -> Iterator[bytes]:
    yield from (bytes([byte]) for byte in f"GET {path} HTTP/1.0\r\n{host}".encode() * 9)


def _huge(rng: random.Random, path: str, host: str) -> Iterator[bytes]:
    yield f"GET {path}{'x' * rng.choice((0, 10**5))} HTTP/1.0\r\n{host}".encode()
    yield from [f"X-{rng.random()}: {'x' * 65000}\r\n".encode()] * 100


def _garbage(rng: random.Random, path: str, host: str) -> Iterator[bytes]:
    request = f"GET {path} HTTP/1.0\r\n{host}\r\n".encode()
    yield rng.choice((rng.randbytes(rng.choice((1, 500, 20_000))), mutate_bytes(rng, request, [request])))


def _odd(rng: random.Random, path: str, host: str) -> Iterator[bytes]:
    after = rng.choice(("", "0", "-1", "x&after=1", "9" * 4000, "%00%ff", "&" * 3000))
    rest = rng.choice(("", "news", "n", "../", "%", ";a?b#c", *[f"news?after={after}"] * 4))
    method = rng.choice(("GET",) * 5 + ("HEAD", "POST", "", "get", "OPTIONS", "GET\t"))
    version = rng.choice(("HTTP/1.0",) * 5 + ("HTTP/1.1", "HTTP/9.9", "", "HTTP/1.0000000"))
    lines = rng.choice((host,) * 5 + ("", "Host: \xff\r\n", host * 60, "Content-Length: 999999999999\r\n" + host))
    yield f"{method} {path}{rest} {version}\r\n{lines}\r\n".encode("latin-1")


def _idle(rng: random.Random, path: str, host: str) -> Iterator[bytes]:
    yield rng.choice((b"", b"G", b"\r\n"))


CLIENT: tuple[Callable[[random.Random, str, str], Iterator[bytes]], ...] = (_slow, _huge, _garbage, _odd, _odd, _idle)

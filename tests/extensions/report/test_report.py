"""The report of `metapp evaluate`: one page that needs no network."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest
import torch

from metapp import door
from metapp.extensions.report.figures import FIGURES


class Page(HTMLParser):
    """What a page holds, as far as it must be right."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.mark.long
def test_the_report_is_one_whole_page_that_needs_no_network(drawn: Path) -> None:
    page = drawn / "report" / "index.html"
    text = page.read_text()
    parsed = Page()
    parsed.feed(text)
    parsed.close()
    assert parsed.open == []
    assert [file.name for file in page.parent.iterdir()] == ["index.html"]
    assert len(text) < 15_000_000
    addresses = [value for _, attributes in parsed.tags for key, value in attributes.items() if key in ("src", "href")]
    assert all(address and address.startswith(("data:", "#")) for address in addresses)
    assert "http://" not in text
    assert "https://" not in text
    assert "@import" not in text
    images = parsed.all("img")
    assert len(images) == 6 + 3 * 6  # the figures, and six pictures a task
    assert all(image["alt"] for image in images)
    ids = [attributes["id"] for _, attributes in parsed.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {address[1:] for address in addresses if address.startswith("#")} <= set(ids)
    assert "{{" not in text
    found = json.loads(text.partition('id="records">')[2].partition("</script>")[0])
    assert set(found) == {"brdf"}
    for button in (each for each in parsed.all("button") if each.get("class") == "record"):
        shown = found["brdf"]["records"][button["data-row"]][button["data-task"]]
        assert found["brdf"]["settings"][shown["key"]]["paradigm"] == button["data-row"]
    for expected in ("metapp evaluate brdf --which all", str(torch.__version__), "4555", "95 % interval"):
        assert expected in text or expected.replace("4555", "4,555") in text
    figures = {file.name for file in (drawn / "figures").iterdir()}
    assert figures == {f"brdf-{name}.{form}" for name in FIGURES for form in ("png", "pdf")}
    assert (drawn / "figures" / "brdf-plane.pdf").read_bytes().startswith(b"%PDF")


def test_a_report_has_and_runs_the_table_that_is_asked_for(evaluate: Callable, tmp_path: Path) -> None:
    assert evaluate("--which", "quickft", "--report", tmp_path / "report", "--quiet", "--json").code == 0
    text = (tmp_path / "report" / "index.html").read_text()
    assert "<h3>Against as many steps of fine-tuning</h3>" in text
    assert "<h3>Methods without a network</h3>" not in text
    assert "<h3>Error and time</h3>" not in text
    assert "metapp evaluate brdf --which quickft" in text
    assert {folder.name for folder in (tmp_path / "runs" / "brdf").iterdir()} == {"general", "meta", "quickft"}


def test_names_of_tasks_are_text(metapp: Callable, neural_fits: Callable[[int], Path], tmp_path: Path) -> None:
    """Whatever a page is put together from, no name is taken for a part of it."""
    names = ["{{picture:x}}", "{0} %s $\\frac$", "<b onload=1>&amp;'\"", "\u0646\u062d\u0627\u0633"]
    for name in names:
        shutil.copytree(neural_fits(1) / "m0", tmp_path / "networks" / name)
    assert metapp("data", "nbrdf", "networks", "--split", "test", "--samples", 256, "--out", "set", "--quiet").code == 0
    words = ("--data", "set", "--out", "runs", "--which", "quickft", "--report", "report", "--quiet", "--json")
    assert metapp("evaluate", "brdf", *words).code == 0
    text = (tmp_path / "report" / "index.html").read_text()
    parsed = Page()
    parsed.feed(text)
    assert parsed.open == []
    assert not any("onload" in attributes for _, attributes in parsed.tags)
    found = json.loads(text.partition('id="records">')[2].partition("</script>")[0])
    assert set(found["brdf"]["records"]["meta"]) == set(names)
    alternatives = [str(image["alt"]) for image in parsed.all("img")]
    assert all(any(each.startswith(f"{name}: ") for each in alternatives) for name in names)


def test_a_report_of_nothing_is_a_page_as_well(evaluate: Callable, tmp_path: Path) -> None:
    assert evaluate("--no-run", "--report", tmp_path / "report", "--quiet").code == 0
    parsed = Page()
    parsed.feed((tmp_path / "report" / "index.html").read_text())
    assert parsed.open == []
    assert "not measured yet" in (tmp_path / "report" / "index.html").read_text()


@pytest.mark.parametrize(("option", "file"), [("--report", "index.html"), ("--figures", "brdf-plane.png")])
def test_files_that_are_there_are_replaced_by_overwrite_alone(
    evaluate: Callable, tmp_path: Path, option: str, file: str
) -> None:
    mine = tmp_path / "out" / file
    mine.parent.mkdir()
    mine.write_text("mine")
    words = ("--no-run", option, mine.parent, "--quiet")
    assert f"{mine}: is there already, expected a new file; add --overwrite" in evaluate(*words).misuse
    assert mine.read_text() == "mine"
    assert evaluate(*words, "--overwrite").code == 0


def test_without_the_extension_tables_are_printed_and_its_options_are_refused(data: Path, tmp_path: Path) -> None:
    environment = os.environ | {door.WITHOUT: "report"}
    command = [sys.executable, "-m", "metapp", "evaluate", "brdf", "--data", data, "--out", tmp_path, "--no-run"]
    done = subprocess.run([*command, "--which", "storage"], capture_output=True, text=True, env=environment, check=True)
    assert "BRDF" in done.stdout
    refused = subprocess.run([*command, "--report", tmp_path], capture_output=True, text=True, env=environment)
    assert refused.returncode == 2
    assert "No such option" in refused.stderr


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="a browser draws the page: apt-get install chromium")
def test_a_browser_shows_the_report_without_an_error(drawn: Path, tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    shot = tmp_path / "shot.png"
    # sort a table and open a record, as a reader does; what goes wrong is said on standard error
    acts = "document.querySelector('.sortable th button').click();document.querySelector('.record').click();"
    acts += "const wide = [...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth).length;"
    acts += "const count = document.querySelector('.sortable tbody').rows.length;"
    acts += "console.log('rows ' + count + ' ' + dialog.open + ', wide tables ' + wide);"
    page.write_text((drawn / "report" / "index.html").read_text().replace("</body>", f"<script>{acts}</script></body>"))
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--window-size=1280,3000"]
    done = subprocess.run(
        [str(BROWSER), *options, f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={shot}", page.as_uri()],
        capture_output=True, text=True, timeout=240, check=True, env=os.environ | {"HOME": str(tmp_path)},
    )  # fmt: skip
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert len(said) == 1, said
    assert "rows 5 true, wide tables 0" in said[0]
    assert shot.stat().st_size > 20_000

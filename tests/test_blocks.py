"""README, guides and the pages beside them: their blocks of code run as they stand, in order, in a new folder.

A comment in the line before a block, `<!-- not run: takes hours -->`, says of one why no test runs it.
"""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.conftest import USER_MATRIX, USER_WEIGHTS, link_into_cache
from tests.needs_mitsuba import skip_without_mitsuba
from tests.shell import forked_commands, run_bash

ROOT = Path(__file__).parent.parent
FENCE = re.compile(
    r"^(?P<before>(?: *<!--[^\n]*-->\n)?)(?P<indent> *)```(?P<kind>\w*)\n(?P<code>.*?)^(?P=indent)```$", re.M | re.S
)
MARK = re.compile(r"<!-- not run: (.+) -->")
RUN = ("bash", "python")
SHOWN = ("console", "text", "toml", "ini", "json", "yaml", "")  # what is printed, or lies in a file


class Block(NamedTuple):
    """A block of code.

    Attributes:
        page: its file.
        line: of its first line of code.
        kind: its language.
        code: as a reader would paste it.
        reason: why no test runs it; "" where one does.
    """

    page: Path
    line: int
    kind: str
    code: str
    reason: str

    def script(self) -> str:
        """What bash runs: the code, or of Python a file of it."""
        python = f"cat > block.py <<'END OF BLOCK'\n{self.code}END OF BLOCK\npython block.py"
        return python if self.kind == "python" else self.code

    def commands(self) -> list[str]:
        """Return the lines without comments, with continued lines joined."""
        lines = re.sub(r"\\\n\s*", "", self.code).splitlines()
        return [command for line in lines if (command := re.sub(r"\s*#.*", "", line).strip())]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks_of(page: Path) -> Iterator[Block]:
    """The blocks of code of a page, in order."""
    text = page.read_text(encoding="utf-8")
    for found in FENCE.finditer(text):
        line = text.count("\n", 0, found.start("code")) + 1
        mark = MARK.search(found["before"])
        yield Block(page, line, found["kind"], textwrap.dedent(found["code"]), mark[1] if mark else "")


DOCS = ROOT / "docs"
NAMES = ("index", "getting-started", "what-can-i-make", "formats", "formats-assets", "api/index")
PAGES = [ROOT / "README.md", *(DOCS / f"{name}.md" for name in NAMES), *sorted((DOCS / "guides").glob("*.md"))]
# why a block may be left out; what is short enough, and needs neither, has to run
REASONS = {
    "sets up an environment",
    "takes minutes",
    "another page runs it",
    "has a test of its own",
    "needs a scheduler",
    "needs photos of your own",
}
LEFT_OUT = [block for page in PAGES for block in blocks_of(page) if block.reason]
# what a reader would have to replace before a line works
PLACEHOLDER = re.compile(r"\b(?:RUN|OTHER_RUN|NAME|DIR|FILE|APP|DATA|URL|ADDRESS)\b|\.\.\.|<[a-z]+>")


def test_blocks_have_a_language_and_those_that_do_not_run_a_reason() -> None:
    for page in PAGES:
        blocks = list(blocks_of(page))
        text = page.read_text(encoding="utf-8")
        assert len(blocks) == len(re.findall(r"^ *```", text, re.M)) / 2, page
        assert len(MARK.findall(text)) == sum(bool(block.reason) for block in blocks), f"{page}: a mark without a block"
        for block in blocks:
            assert block.kind in (*RUN, *SHOWN), block
            assert not block.reason or (block.kind in RUN and block.reason in REASONS), block


def test_blocks_left_to_another_page_run_there() -> None:
    lines = {line for page in PAGES for block in blocks_of(page) if not block.reason for line in block.commands()}
    for block in LEFT_OUT:
        if block.reason == "another page runs it":
            assert lines >= set(block.commands()), block


def test_blocks_that_run_have_no_placeholders() -> None:
    for page in PAGES:
        for block in blocks_of(page):
            if block.kind in RUN and not block.reason:
                code = re.sub(r"#.*", "", block.code)
                assert not PLACEHOLDER.search(code), (str(block), PLACEHOLDER.search(code))


@pytest.mark.long
@pytest.mark.usefixtures("compiled_in_cache")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_blocks_of_a_page_run(page: Path, cache: Path, tmp_path: Path) -> None:
    """They run in a folder that has `examples`, as a clone has; pages open in no browser."""
    blocks = [block for block in blocks_of(page) if block.kind in RUN and not block.reason]
    code = "".join(block.code for block in blocks)
    if re.search(r"illumination|transport|mitsuba", code):
        skip_without_mitsuba()
        link_into_cache(USER_MATRIX, cache, "the second scene's matrix is not there: make setup builds it")
    if re.search(r"texture|svbrdf_stationary|metapp try", code):
        link_into_cache(USER_WEIGHTS, cache, "the VGG weights are not there: metapp data vgg fetches them")
    clone = tmp_path / "clone"
    clone.mkdir()
    (clone / "examples").symlink_to(ROOT / "examples")
    with forked_commands(tmp_path / "bin") as environment:
        for block in blocks:
            code, output = run_bash(block.script(), clone, {**environment, "BROWSER": "true"})
            assert code == 0, f"{block}: exit code {code}\n{block.code}\n{output}"
    called = tmp_path / "bin" / "seconds.txt"  # pages that have left out all blocks call nothing
    print(called.read_text(encoding="utf-8") if called.exists() else "")

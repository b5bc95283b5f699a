"""The smallest extensions of docs/developers/extend.md, as modules of a package beside metapp."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.shell import many_commands

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "developers" / "extend.md"


@pytest.mark.usefixtures("compiled")
def test_a_rule_a_baseline_and_an_export_of_the_page_work(neural_fits: Callable[[int], Path], tmp_path: Path) -> None:
    (neural_fits(1) / "m0").rename(tmp_path / "gold")
    packages = tmp_path / "packages"
    info = packages / "mine-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 0.1\n")
    names = ("damped", "mine")
    (info / "entry_points.txt").write_text("[metapp.extensions]\n" + "".join(f"{name} = {name}\n" for name in names))
    for name, text in re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE.read_text(), re.DOTALL):
        (packages / name).write_text(text)
    quick = ("--recipe", "quick", "--quiet")
    said = many_commands(
        ("data", "synth", "brdf", "--count", 5, "--out", "set", "--quiet"),
        ("meta", "brdf", "--data", "set", "--rule", "meta-damped", "--train", "--train-steps", 1, "--json", *quick),
        ("meta", "brdf", "--help"),
        ("baseline", "brdf", "gold", "--method", "mean", "--json", "--quiet"),
        ("general", "brdf", "gold", "--export", "text", "--out", "runs", *quick),
        folder=tmp_path,
        PYTHONPATH=os.pathsep.join(filter(None, [str(packages), str(ROOT), os.environ.get("PYTHONPATH", "")])),
    )
    fit = json.loads(said[1])
    assert fit["rule"] == "meta-damped"
    assert fit["error"] > 0
    assert "meta-damped" in said[2]
    assert 0 < json.loads(said[3])["tasks"][0]["error"] < 100
    (file,) = (tmp_path / "runs").rglob("text/gold.txt")
    assert "w1 (21, 6)" in file.read_text()

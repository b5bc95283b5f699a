"""What shells complete, and that it takes no large import."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from data_tools.formats import exports_of
from metapp.apps import app_names
from metapp.cli import main
from metapp.evaluation.tables import table_names
from metapp.learning.names import rule_names


@pytest.fixture
def completed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """The words that bash is offered for the last one of a line."""

    def complete(line: str) -> list[str]:
        monkeypatch.setenv("_METAPP_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(line.count(" ")))
        with pytest.raises(SystemExit):
            main()
        return capsys.readouterr().out.split()

    return complete


SMALLER = ["paper-64", "paper-128"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("metapp eva", ["evaluate"]),
        ("metapp data mer", ["merl"]),
        ("metapp meta ", app_names()),
        ("metapp plan ", ["brdf"]),
        ("metapp examples t", ["texture", "transport"]),
        ("metapp data synth sv", ["svbrdf_nonstationary", "svbrdf_stationary"]),
        ("metapp meta svbrdf_nonstationary --recipe ", ["quick", "full", "paper", *SMALLER, "pretrained", "several"]),
        ("metapp meta texture --recipe ", ["quick", "full", "paper", *SMALLER]),
        ("metapp meta --recipe ani", ["anisotropic"]),
        ("metapp meta brdf --rule meta-", [name for name in rule_names() if name.startswith("meta-")]),
        ("metapp meta brdf --rule adam+cu", ["adam+curvature"]),
        ("metapp meta texture --export ", list(exports_of("texture"))),
        ("metapp meta svbrdf_stationary --export gltf,b", ["gltf,blender"]),
        ("metapp export runs/brdf/meta/gold m", ["materialx", "merl", "mitsuba"]),
        ("metapp meta illumination --observe ", ["reference", "photo"]),
        ("metapp general texture --device c", ["cpu", "cuda"]),
        ("metapp baseline texture --method ", ["nearest", "quilting", "gpdm", "patches"]),
        ("metapp evaluate --which ", [*table_names(), "all"]),
        ("metapp evaluate brdf transport --recipe f", ["full", "few"]),
    ],
)
def test_names_are_completed(completed, line: str, words: list[str]) -> None:
    assert completed(line) == words


def test_completion_imports_nothing_large() -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'numpy', 'rich.console'} & sys.modules.keys())"
    line = {"_METAPP_COMPLETE": "complete_bash", "COMP_WORDS": "metapp meta brdf --recipe ", "COMP_CWORD": "4"}
    done = subprocess.run(
        [sys.executable, "-c", lines], capture_output=True, text=True, env=os.environ | line, check=True
    )
    assert done.stdout.splitlines()[-1] == "set()"

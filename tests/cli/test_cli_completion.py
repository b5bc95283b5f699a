"""What shells complete, and that it takes no large import."""

from __future__ import annotations

import os
import subprocess
import sys


def test_completion_imports_nothing_large() -> None:
    lines = "import sys\nfrom metapp.cli import main\ntry:\n    main()\nfinally:\n"
    lines += "    print({'torch', 'mitsuba', 'numpy', 'rich.console'} & sys.modules.keys())"
    line = {"_METAPP_COMPLETE": "complete_bash", "COMP_WORDS": "metapp meta brdf --recipe ", "COMP_CWORD": "4"}
    done = subprocess.run(
        [sys.executable, "-c", lines], capture_output=True, text=True, env=os.environ | line, check=True
    )
    *words, imported = done.stdout.splitlines()
    assert {"quick", "full", "few"} <= set(words)
    assert imported == "set()"

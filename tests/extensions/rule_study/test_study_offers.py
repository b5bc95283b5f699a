"""What the extension offers, and tables without it."""

from __future__ import annotations

import os
import subprocess
import sys

from metapp import door


def test_without_it_there_is_no_such_table_nor_its_options() -> None:
    environment = os.environ | {door.WITHOUT: "rule_study", "COLUMNS": "200"}
    command = [sys.executable, "-m", "metapp", "evaluate"]
    refused = subprocess.run(
        [*command, "--which", "rules"], capture_output=True, text=True, env=environment, check=False
    )
    assert refused.returncode == 2
    assert "a table of the extension rule_study" in refused.stderr
    text = subprocess.run([*command, "--help"], capture_output=True, text=True, env=environment, check=True).stdout
    assert "--overfit-share" in text
    assert "--train-steps" not in text

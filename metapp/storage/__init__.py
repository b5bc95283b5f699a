"""All that touches the disk: files, shards, records, checkpoints."""

from __future__ import annotations

from typing import Any

Document = dict[str, Any]  # a JSON object: a record, its settings, what a file says about itself

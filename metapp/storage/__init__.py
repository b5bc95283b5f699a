"""All that touches the disk.

In order of reading: `files` reads and writes single files whole or not at all, `folders` tells what a folder is,
`shards` has data sets, `fit_folders` and `parameters` have fits,
`checkpoint_files` and `shipped_checkpoints` have checkpoints, `image_writers` and `xml_files` write formats,
`cache_folders`, `tensor_cache` and `downloads` have what can be made or downloaded again.
"""

from __future__ import annotations

from typing import Any

Document = dict[str, Any]  # a JSON object: a record, the settings in it, or the description of a checkpoint

"""All that touches the disk: files, shards, records, checkpoints."""

"""BRDFs of few samples: goniometer tables, the recipe that fits them, and plans of measurements."""

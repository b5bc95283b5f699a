"""Files and synthetic data as tasks."""

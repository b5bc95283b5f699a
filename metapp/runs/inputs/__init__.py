"""What fits read: files, data sets, objects in memory."""

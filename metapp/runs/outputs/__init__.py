"""What runs leave: files, pictures, records."""

"""`metapp data`: turn measurements and models into task shards."""

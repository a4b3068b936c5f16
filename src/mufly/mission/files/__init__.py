"""Mission files: schema, items, fences, ground files, checks and timing."""

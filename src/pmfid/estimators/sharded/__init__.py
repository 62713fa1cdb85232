"""Very many axes in one process: in shards, added and removed while running, kept on disk."""

"""Worker processes, the shared block, and what the system allows."""

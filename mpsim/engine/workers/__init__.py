"""Worker processes, the shared block, and limits of the system."""

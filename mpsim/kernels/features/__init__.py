"""What features add to a frame; a feature that is None compiles to nothing."""

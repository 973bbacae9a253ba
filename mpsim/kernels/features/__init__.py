"""What features add to a frame; None compiles to nothing."""

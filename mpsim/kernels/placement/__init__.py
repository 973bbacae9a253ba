"""Places of discs before the first frame."""

"""The exact solver. It shares no code with the stepped one, so that a bug in one cannot hide in the other."""

"""The exact solver. It shares nothing with the stepped one, so that the two cannot share a mistake."""

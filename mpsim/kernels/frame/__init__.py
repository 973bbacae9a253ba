"""One frame of the stepped solver: move, sort, contacts."""

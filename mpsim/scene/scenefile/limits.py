"""How large a scene file and its arrays may be: far beyond any scene, and little enough to be refused at once.

What a reader must look through one by one in Python is bounded here; long arrays of numbers lie in .npy files.
"""

MOST_BYTES = 2**20
"""Bytes of the scene file itself: some 20,000 lines."""

MOST_TABLES = 10_000
"""Tables of one kind: [[discs]], or those of a feature. One table may hold very many, as arrays."""

MOST_PARTS = 16
"""Parts of a dotted key. No key of a scene file has more than two; a parser takes their square in time."""

MOST_PROBLEMS = 100
"""Problems of one file that are named."""

MOST_ARRAY_BYTES = 2**33
"""Bytes of all array files of a scene together: those of the largest scene."""

MOST_CSV = 2**23
"""Bytes of a .csv file, which is read word by word."""

"""Largest scene file and arrays that are read.

They bound what is processed item by item in Python; long arrays of numbers belong in .npy files.
"""

MOST_BYTES = 2**20
"""Bytes of the scene file itself: about 20,000 lines."""

MOST_TABLES = 10_000
"""Tables of one kind: [[discs]], or those of a feature. One table may hold very many, as arrays."""

MOST_PARTS = 16
"""Parts of a dotted key. No key of a scene file has more than two; a parser's time grows with their square."""

MOST_PROBLEMS = 100
"""Problems of one file that are reported."""

MOST_ARRAY_BYTES = 2**33
"""Bytes of all array files of a scene together: enough for the largest scene."""

MOST_CSV = 2**23
"""Bytes of a .csv file, which is read cell by cell."""

"""Texts of scene files."""

HEAD = "schema = 1\nwidth = 10.0\nheight = 8.0\n"

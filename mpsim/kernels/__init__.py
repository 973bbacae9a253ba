"""Compiled loops, and the records and arrays that they work on: no process, no file, no plot."""

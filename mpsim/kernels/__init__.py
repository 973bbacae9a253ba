"""Compiled loops only: no process, no file, no plot, and nothing of the rest of mpsim is imported here."""

"""Compiled loops only: no process, no file, no plot; of the rest of mpsim only interrupts.py is imported here."""

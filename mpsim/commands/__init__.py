"""The commands of `mpsim`, one module per group; terminal.py holds what they share."""

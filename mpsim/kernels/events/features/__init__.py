"""Features in the exact solver: one file each; hooks.py lists them."""

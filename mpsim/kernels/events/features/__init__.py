"""What only some scenes have, in the exact solver: each file owns the law of one feature, hooks.py lists them."""

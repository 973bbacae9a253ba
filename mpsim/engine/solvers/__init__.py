"""The solvers as the coordinator sees them, and which one a run uses."""

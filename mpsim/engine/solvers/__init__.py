"""The solvers, and the choice of the solver of a run."""

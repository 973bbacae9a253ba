"""The method mpi: a scene shared by the ranks of MPI."""

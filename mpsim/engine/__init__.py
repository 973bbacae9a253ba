"""The engine: processes, shared memory and the frame loop around the kernels."""

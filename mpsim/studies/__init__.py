"""Many runs: what settings cost and how wrong they are, benchmarks, the map of stability."""

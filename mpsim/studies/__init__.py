"""Studies of many runs: cost and errors of settings, benchmarks, the stability map."""

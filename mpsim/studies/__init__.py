"""Studies of many runs: cost and errors of settings, sweeps, expected numbers of named scenes."""

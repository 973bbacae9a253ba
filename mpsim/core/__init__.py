"""Basic modules that all packages use: errors, checks of input and files, columns of a state."""

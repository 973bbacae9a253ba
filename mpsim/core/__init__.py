"""What every other package stands on: errors, the gates for input and files, the columns of a state."""

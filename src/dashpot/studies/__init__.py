"""Studies that a command reproduces."""

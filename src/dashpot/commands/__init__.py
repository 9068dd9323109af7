"""What the commands of `dashpot.cli` do; imported only when one runs."""

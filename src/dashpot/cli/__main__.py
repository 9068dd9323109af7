"""``python -m dashpot.cli``."""

from dashpot.cli import main

if __name__ == "__main__":
    main()

"""A controller as C99 source or as an FMU, equal to the one in Python to the bit (docs/export.md)."""

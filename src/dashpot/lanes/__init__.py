"""The vectorised arm: scenarios of one robot side by side, in lanes of vector registers (docs/lanes.md)."""

from dashpot.lanes.run import WIDTHS, run_lanes, unfit
from dashpot.lanes.tree import Tree, tree_of

__all__ = ["WIDTHS", "Tree", "run_lanes", "tree_of", "unfit"]

"""Controllers on robots: the interface to a robot, the real-time loop, and the checks before it.

docs/hardware.md explains them.

Nothing is imported here: a robot's adapter needs `dashpot.hardware.interface` alone.
"""

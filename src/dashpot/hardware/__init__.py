"""Controllers on robots: the interface to a robot, the real-time loop, the checks before it (docs/hardware.md).

Nothing is imported here: a robot's adapter needs `dashpot.hardware.interface` alone.
"""

"""The closed loop in time: trajectories, faults, scenarios, recordings."""

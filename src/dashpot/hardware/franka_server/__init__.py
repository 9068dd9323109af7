"""A Franka robot's control interface in front of a simulated arm whose torque sensors are real ones."""

"""What runs on the robot: sampled joint laws, the controller, its supervisor."""

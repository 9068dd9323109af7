"""Robots: what a controller runs on, real or simulated."""

"""Motions along a path that is known before the motion starts: paths with waypoints, and trajectories."""

"""Motions along a path that is known at the start: paths, trajectories, waypoints, and taught waypoints."""

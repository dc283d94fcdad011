"""Motions along a path that is known when they begin: paths, trajectories, waypoints, and what was taught by hand."""

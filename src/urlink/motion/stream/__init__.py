"""Motions along points that are appended while the arm moves, for one arm and for groups of arms."""

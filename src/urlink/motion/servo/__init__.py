"""Motions led cycle by cycle: servo loops, following, jogging, force control, and the links to their programs."""

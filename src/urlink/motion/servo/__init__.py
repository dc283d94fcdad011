"""Motions controlled cycle by cycle: servo loops, following, jogging, force control, and their programs."""

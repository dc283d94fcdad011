"""Motions that are controlled in each cycle: servo loops, trajectory following, jogging and force control."""

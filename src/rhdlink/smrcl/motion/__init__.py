"""Motions of a robot, with one class for each motion, and the state that all motions share."""

"""The motions of a robot: one class for each motion, and the state that all of them share."""

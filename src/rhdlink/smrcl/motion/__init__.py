"""The motions of a robot: one class for each, and the state that they share."""

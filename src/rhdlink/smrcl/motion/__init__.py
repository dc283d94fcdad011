"""What moves the robot: one class for each motion, and the state that they share."""

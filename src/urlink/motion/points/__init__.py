"""Points: taught positions of the arm with names, in a file; `robot.points` is a `Points`."""

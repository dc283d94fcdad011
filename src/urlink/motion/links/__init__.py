"""Links to a program on the robot: a connection that it makes to this computer, or input registers."""

"""Links to a program on the robot: a connection from the program to this computer, or input registers."""

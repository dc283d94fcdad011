"""SMR-CL: the mission language of DTU's mobile robots, executed in Python."""

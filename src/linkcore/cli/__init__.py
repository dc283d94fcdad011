"""What the command lines of the packages share; it knows no robot."""

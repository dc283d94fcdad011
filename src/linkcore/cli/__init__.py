"""What the command lines of the packages have in common, without knowledge of any robot."""

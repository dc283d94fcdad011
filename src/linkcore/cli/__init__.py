"""Common parts of the command lines of all packages, which do not depend on any robot."""

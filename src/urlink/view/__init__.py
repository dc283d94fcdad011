"""A robot, or a recording, in 3D in a browser; needs the extra ``view``."""

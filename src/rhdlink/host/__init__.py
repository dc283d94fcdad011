"""A robot in Python: plugins, the tick that drives them, and the server that RHD clients connect to."""

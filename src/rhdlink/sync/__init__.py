"""The connection to a server, the copy of its variables, and the thread that keeps them equal."""

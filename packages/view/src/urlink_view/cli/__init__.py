"""Commands `urlink view` and `urlink foxglove`."""

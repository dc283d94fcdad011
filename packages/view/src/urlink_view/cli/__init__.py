"""The commands `urlink view` and `urlink foxglove`."""

"""A robot, or a recording, in 3D in a browser, in Foxglove, and as an MCAP file while it goes on."""

"""A robot, or a recording, in 3D in a browser, in Foxglove, and as an MCAP file while it goes on."""

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

"""View of a robot or a recording: in 3D in a browser, in Foxglove, and as an MCAP file that is recorded live."""

# Imported before urlink, so that a warning about another distribution of this name precedes a failing import.
import linkcore  # noqa: F401

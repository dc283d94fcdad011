"""Plugins that are part of the host: a bridge for velocities, a turtle world, and a logger."""

"""Plugins that come with the host: a bridge for velocities, a turtle world, a logger."""

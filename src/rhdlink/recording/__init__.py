"""Connections written down, and lived through again: the bytes of a robot in linkcore's recording format."""

"""Identification: what a recording tells of the arm that was recorded, each number with its interval."""

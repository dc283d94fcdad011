"""Recordings as arrays, pictures and files of other programs."""

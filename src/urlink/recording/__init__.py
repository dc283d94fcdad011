"""Recordings as arrays, plots and files for other programs."""

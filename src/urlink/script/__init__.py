"""The only package that builds URScript text."""

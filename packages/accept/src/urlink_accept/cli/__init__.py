"""Commands `urlink accept`, `urlink exercise`, `urlink identify` and `urlink compare`."""

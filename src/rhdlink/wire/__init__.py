"""The RHD byte format, sans-IO: declared in `schema`, encoded and decoded beside it."""

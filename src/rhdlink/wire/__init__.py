"""The RHD byte format, sans-IO: `schema` declares it, and the other modules encode and decode it."""

"""The RHD byte format, sans-IO: declarations in `schema`, encoders and decoders."""

"""Byte format of RHD, without sockets (sans-IO): declarations in `schema`, encoders and decoders."""

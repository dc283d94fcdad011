"""The interfaces of a simulated controller, one handler for each: bytes in, packets out, no sockets."""

"""Interfaces of a simulated controller: handlers without sockets, bytes in, packets out."""

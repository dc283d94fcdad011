"""Interfaces of a simulated controller. They process bytes and return packets, without sockets."""

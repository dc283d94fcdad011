"""Mobile robots that run the Robot Hardware Daemon (RHD): their variable database as typed Python.

Importing it starts nothing and touches no network.
"""

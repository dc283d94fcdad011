"""URScript as text: the one package in which it is built."""

"""The variable database: tables of words, what the words mean, and how classes declare them."""

"""The programs of a simulated controller: loaded from text, run cycle by cycle, and the pendant that plays them."""

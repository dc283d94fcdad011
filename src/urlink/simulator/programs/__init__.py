"""Programs of a simulated controller: loading, running cycle by cycle, and the pendant."""
